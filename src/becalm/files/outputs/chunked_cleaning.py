"""Clean a file chunk by chunk with a recipe. Channels run in parallel, and finished chunks are written meanwhile."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple, Protocol, Self

import numpy as np
import pyarrow as pa

from becalm.cleaning.cleaner import Cleaner
from becalm.core.arrays import BLOCK
from becalm.files.outputs.tables import CleanChannel, output_block
from becalm.files.rows import block_rows

if TYPE_CHECKING:
    from becalm.cleaning.channels.report import ChannelReport
    from becalm.cleaning.recipes.recipe import ChannelRecipe, Recipe
    from becalm.core.arrays import Floats
    from becalm.core.rows import EstimatedRows, Judge
    from becalm.core.time.clock import Clock
    from becalm.files.inputs.opening import Chunk, OpenSource

CHUNK_ROWS = 1 << 18
"""The most rows that are cleaned at once: enough work for all threads, but a moderate use of memory."""


class ChunkObserver(Protocol):
    """An object that observes the cleaning of a file, such as `becalm.report.gathering.Gathering`."""

    @property
    def looks(self) -> Sequence[Judge]:
        """One observer per channel; it receives the channel's innovations and their standard deviations."""
        ...

    def add(self, columns: Sequence[Floats], elapsed: Floats, estimates: Sequence[EstimatedRows]) -> None:
        """Take some rows of all channels: measurements, elapsed steps and the estimates of the filters."""
        ...


class ChunkSource(Protocol):
    """The properties of a source that decide how many of its rows are cleaned at once."""

    schema: pa.Schema
    clock: Clock


def rows_of_chunks(source: ChunkSource, channels: int) -> int:
    """Return how many rows to clean at once: a multiple of BLOCK, so that estimates do not depend on this number."""
    rows = min(CHUNK_ROWS, block_rows(source.schema))
    if not source.clock.uniform:  # each row then needs its own step matrices in each channel
        rows = min(rows, max(CHUNK_ROWS // max(4, channels), 16 * BLOCK))
    return max(BLOCK, rows // BLOCK * BLOCK)


def clean_chunks(  # noqa: PLR0913  (the options are passed by name)
    source: OpenSource,
    recipe: Recipe,
    write: Callable[[pa.Table], None],
    step: Callable[[str, int], None],
    *,
    split: bool = False,
    verdicts: bool = False,
    gathering: ChunkObserver | None = None,
) -> tuple[ChannelReport, ...]:
    """Clean a file and write the result.

    Parameters
    ----------
    source : OpenSource
        The file.
    recipe : Recipe
        The filters of its channels.
    write : callable
        Writes the next clean rows, a pyarrow table.
    step : callable
        Called after each chunk with a text ("") and the number of its rows, to show progress.
    split : bool
        Write the parts of each channel too.
    verdicts : bool
        Write the verdict on each measurement too.
    gathering : ChunkObserver, optional
        An observer that collects data for the figures of the report.

    Returns
    -------
    tuple of ChannelReport
        One report per channel.

    Raises
    ------
    BecalmError
        If the file is damaged, or the output cannot be written.
    """
    looks = [] if gathering is None else gathering.looks
    chunks = source.chunks(rows_of_chunks(source, len(recipe.channel)))
    with (
        nullcontext() if gathering is None else _BackgroundObserver(gathering) as observer,
        Cleaner(recipe, source.clock.step_s, split=split, innovation_callbacks=looks) as cleaner,
    ):
        for clean in iter_clean_chunks(cleaner, recipe, with_progress(chunks, step)):
            if observer is not None:
                observer.add(columns_of(clean.chunk, recipe), clean.chunk.elapsed_steps, clean.estimates)
            write(clean.output(recipe, verdicts=verdicts))
        return cleaner.reports()


def with_progress(chunks: Iterable[Chunk], step: Callable[[str, int], None]) -> Iterator[Chunk]:
    """Yield chunks; once the caller asks for the next chunk, call `step` with the number of rows of the last."""
    for chunk in chunks:
        yield chunk
        step("", len(chunk))


class CleanChunk(NamedTuple):
    """A chunk of rows with the estimates of each channel."""

    chunk: Chunk
    estimates: list[EstimatedRows]  # one per channel

    def output(self, recipe: Recipe, *, verdicts: bool = False) -> pa.Table:
        """Return the table of the chunk with clean channels and, if `verdicts`, the verdict on each measurement."""
        named = zip(recipe.channel, self.estimates, strict=True)
        return output_block(self.chunk.table, {one.name: _clean_channel(one, clean, verdicts) for one, clean in named})


def iter_clean_chunks(
    cleaner: Cleaner, recipe: Recipe, chunks: Iterable[Chunk], *, ends: bool = True
) -> Iterator[CleanChunk]:
    """Yield each chunk of rows as soon as it is clean.

    Parameters
    ----------
    cleaner : Cleaner
        The filters of all channels.
    recipe : Recipe
        The recipe that names the channels.
    chunks : iterable of Chunk
        Consecutive rows.
    ends : bool
        Whether the last chunk ends the recording. If not, the cleaner keeps the rows whose estimates need later rows.
    """
    waiting: deque[Chunk] = deque()

    def ready(estimates: list[list[EstimatedRows]]) -> Iterator[CleanChunk]:
        return (CleanChunk(waiting.popleft(), channels) for channels in estimates)

    for chunk in chunks:
        waiting.append(chunk)
        yield from ready(cleaner.push(columns_of(chunk, recipe), chunk.elapsed_steps))
    if ends:
        yield from ready(cleaner.finish())


def columns_of(chunk: Chunk, recipe: Recipe) -> list[Floats]:
    """Return the measurements of each channel of a recipe, (n,) each, NaN where missing."""
    return [chunk.channel(chunk.names.index(channel.name)) for channel in recipe.channel]


class _BackgroundObserver:
    """An observer that runs in a thread while the next rows are cleaned, one chunk at a time and in order."""

    def __init__(self, gathering: ChunkObserver) -> None:
        self._gathering, self._pool = gathering, ThreadPoolExecutor(1)
        self._last: Future[None] | None = None

    def add(self, columns: list[Floats], elapsed: Floats, estimates: list[EstimatedRows]) -> None:
        """Pass some rows to the observer, after it has finished the previous rows."""
        self._wait()
        self._last = self._pool.submit(self._gathering.add, columns, elapsed, estimates)

    def _wait(self) -> None:
        if self._last is not None:
            self._last.result()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, cause: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait until all rows are observed; after an exception, cancel what is pending."""
        self._pool.shutdown(cancel_futures=kind is not None)
        if kind is None:
            self._wait()


def _clean_channel(channel: ChannelRecipe, estimates: EstimatedRows, verdicts: bool) -> CleanChannel:
    parts = {part: np.ascontiguousarray(values) for part, values in zip(channel.parts, estimates.parts, strict=False)}
    codes = estimates.verdicts if verdicts else None
    return CleanChannel(estimates.signal, estimates.sigma, channel.unit, parts, codes)
