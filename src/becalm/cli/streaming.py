"""A file through a recipe, chunk by chunk: channels are cleaned side by side, and written beside that."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from types import TracebackType
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np
import pyarrow as pa

from becalm.cleaning.cleaner import Cleaner
from becalm.core.kernel_ahead import BLOCK
from becalm.files.rows import block_rows
from becalm.files.tables import CleanChannel, output_block

if TYPE_CHECKING:
    from becalm.cleaning.recipe import ChannelRecipe, Recipe
    from becalm.cleaning.report import ChannelReport
    from becalm.core.arrays import Floats
    from becalm.core.told import Told
    from becalm.files.opening import OpenSource
    from becalm.report.gathering import Gathering

CHUNK_ROWS = 1 << 18
"""Rows that are cleaned at once: much to do, and little to hold."""


def rows_of_chunks(source: OpenSource, channels: int) -> int:
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
    gathering: Gathering | None = None,
) -> tuple[ChannelReport, ...]:
    """Clean a file, and write it; `step` is called after each chunk, with its rows.

    Split, the parts of each channel are written too; with verdicts, what became of each reading; and what pictures
    need is gathered, where it is asked for.

    Raises
    ------
    BecalmError
        If the file turns out to be damaged, or cannot be written.
    """
    waiting: deque[_Waiting] = deque()
    numbers = [source.names.index(channel.name) for channel in recipe.channel]

    def answer(told: list[Told]) -> None:
        table, columns, elapsed = waiting.popleft()
        if behind is not None:
            behind.add(columns, elapsed, told)
        write(_output(table, recipe, told, verdicts))

    looks = [] if gathering is None else [channel.look for channel in gathering.channels]
    with (
        nullcontext() if gathering is None else _Behind(gathering) as behind,
        Cleaner(recipe, source.clock.step_s, split=split, looks=looks) as cleaner,
    ):
        for chunk in source.chunks(rows_of_chunks(source, len(numbers))):
            columns = [chunk.channel(number) for number in numbers]
            waiting.append(_Waiting(chunk.table, [] if gathering is None else columns, chunk.elapsed_steps))
            for told in cleaner.push(columns, chunk.elapsed_steps):
                answer(told)
            step("", len(chunk))
        for told in cleaner.finish():
            answer(told)
        return cleaner.reports()


class _Behind:
    """Gathers beside the cleaning of the next rows: one stretch at a time, in order."""

    def __init__(self, gathering: Gathering) -> None:
        self._gathering, self._pool = gathering, ThreadPoolExecutor(1)
        self._last: Future[None] | None = None

    def add(self, columns: list[Floats], elapsed: Floats, told: list[Told]) -> None:
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


class _Waiting(NamedTuple):
    """A chunk that was not answered yet."""

    table: pa.Table
    columns: list[Floats]  # where they are to be drawn
    elapsed: Floats


def _output(table: pa.Table, recipe: Recipe, told: list[Told], verdicts: bool) -> pa.Table:
    named = zip(recipe.channel, told, strict=True)
    return output_block(table, {one.name: _clean_channel(one, clean, verdicts) for one, clean in named})


def _clean_channel(channel: ChannelRecipe, told: Told, verdicts: bool) -> CleanChannel:
    parts = {part: np.ascontiguousarray(values) for part, values in zip(channel.parts, told.parts, strict=False)}
    return CleanChannel(told.signal, told.sigma, channel.unit, parts, told.verdicts if verdicts else None)
