"""Clean a file chunk by chunk with a recipe: channels run side by side, and earlier chunks are written meanwhile."""

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
from becalm.files.rows import block_rows
from becalm.files.tables import CleanChannel, output_block

if TYPE_CHECKING:
    from becalm.cleaning.recipe import ChannelRecipe, Recipe
    from becalm.cleaning.report import ChannelReport
    from becalm.core.arrays import Floats
    from becalm.core.rows import EstimatedRows, Judge
    from becalm.core.time.clock import Clock
    from becalm.files.chunk import Chunk
    from becalm.files.opening import OpenSource

CHUNK_ROWS = 1 << 18
"""Rows that are cleaned at once: much to do, and little to hold."""


class ChunkObserver(Protocol):
    """What looks on while a file goes through, such as `becalm.report.gathering.Gathering`."""

    @property
    def looks(self) -> Sequence[Judge]:
        """One a channel, which is given its innovations and their standard deviations."""
        ...

    def add(self, columns: Sequence[Floats], elapsed: Floats, told: Sequence[EstimatedRows]) -> None:
        """Take some rows of all channels, and what was told of them."""
        ...


class ChunkSource(Protocol):
    """What is cleaned, as far as it tells how much of it to clean at once."""

    schema: pa.Schema
    clock: Clock


def rows_of_chunks(source: ChunkSource, channels: int) -> int:
    """Return how many rows to clean at once, in whole blocks, so that where a file is cut changes no bit."""
    rows = min(CHUNK_ROWS, block_rows(source.schema))
    if not source.clock.uniform:  # then each row has step matrices of its own, in each channel
        rows = min(rows, max(CHUNK_ROWS // max(4, channels), 16 * BLOCK))
    return max(BLOCK, rows // BLOCK * BLOCK)


def clean_chunks(  # noqa: PLR0913  (each by its name)
    source: OpenSource,
    recipe: Recipe,
    write: Callable[[pa.Table], None],
    step: Callable[[str, int], None],
    *,
    split: bool = False,
    verdicts: bool = False,
    gathering: ChunkObserver | None = None,
) -> tuple[ChannelReport, ...]:
    """Clean a file, and write it; `step` is called after each chunk, with its rows.

    Split, the parts of each channel are written too; with verdicts, what became of each reading; and what pictures
    need is gathered, where it is asked for.

    Raises
    ------
    BecalmError
        If the file turns out to be damaged, or cannot be written.
    """
    looks = [] if gathering is None else gathering.looks
    chunks = source.chunks(rows_of_chunks(source, len(recipe.channel)))
    with (
        nullcontext() if gathering is None else _Behind(gathering) as behind,
        Cleaner(recipe, source.clock.step_s, split=split, looks=looks) as cleaner,
    ):
        for answer in answered(cleaner, recipe, counted(chunks, step)):
            if behind is not None:
                behind.add(columns_of(answer.chunk, recipe), answer.chunk.elapsed_steps, answer.told)
            write(answer.output(recipe, verdicts=verdicts))
        return cleaner.reports()


def counted(chunks: Iterable[Chunk], step: Callable[[str, int], None]) -> Iterator[Chunk]:
    """Give chunks, and tell after each how many rows it had."""
    for chunk in chunks:
        yield chunk
        step("", len(chunk))


class CleanChunk(NamedTuple):
    """A chunk of rows that is clean."""

    chunk: Chunk
    told: list[EstimatedRows]  # of each channel

    def output(self, recipe: Recipe, *, verdicts: bool = False) -> pa.Table:
        """Return its table with clean channels; with verdicts, what became of each reading too."""
        named = zip(recipe.channel, self.told, strict=True)
        return output_block(self.chunk.table, {one.name: _clean_channel(one, clean, verdicts) for one, clean in named})


def answered(cleaner: Cleaner, recipe: Recipe, chunks: Iterable[Chunk], *, ends: bool = True) -> Iterator[CleanChunk]:
    """Give each chunk of rows as soon as it is clean; unless they are the last, what waits for later ones stays."""
    waiting: deque[Chunk] = deque()

    def ready(told: list[list[EstimatedRows]]) -> Iterator[CleanChunk]:
        return (CleanChunk(waiting.popleft(), channels) for channels in told)

    for chunk in chunks:
        waiting.append(chunk)
        yield from ready(cleaner.push(columns_of(chunk, recipe), chunk.elapsed_steps))
    if ends:
        yield from ready(cleaner.finish())


def columns_of(chunk: Chunk, recipe: Recipe) -> list[Floats]:
    """Return the readings of each channel of a recipe, (n,) each, NaN where missing."""
    return [chunk.channel(chunk.names.index(channel.name)) for channel in recipe.channel]


class _Behind:
    """Gathers beside the cleaning of the next rows: one stretch at a time, in order."""

    def __init__(self, gathering: ChunkObserver) -> None:
        self._gathering, self._pool = gathering, ThreadPoolExecutor(1)
        self._last: Future[None] | None = None

    def add(self, columns: list[Floats], elapsed: Floats, told: list[EstimatedRows]) -> None:
        """Gather some rows, once those before them are."""
        self._wait()
        self._last = self._pool.submit(self._gathering.add, columns, elapsed, told)

    def _wait(self) -> None:
        if self._last is not None:
            self._last.result()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, cause: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Wait for the rest, or leave it where something went wrong."""
        self._pool.shutdown(cancel_futures=kind is not None)
        if kind is None:
            self._wait()


def _clean_channel(channel: ChannelRecipe, told: EstimatedRows, verdicts: bool) -> CleanChannel:
    parts = {part: np.ascontiguousarray(values) for part, values in zip(channel.parts, told.parts, strict=False)}
    return CleanChannel(told.signal, told.sigma, channel.unit, parts, told.verdicts if verdicts else None)
