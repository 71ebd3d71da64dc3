"""A file through a recipe, chunk by chunk: channels are cleaned side by side, and written beside that."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

import pyarrow as pa

from becalm.cleaning.cleaner import Cleaner
from becalm.core.kernel_ahead import BLOCK
from becalm.files.rows import block_rows
from becalm.files.tables import CleanChannel, output_block

if TYPE_CHECKING:
    from becalm.cleaning.judging import ChannelReport
    from becalm.cleaning.recipe import Recipe
    from becalm.core.flow import Told
    from becalm.files.opening import OpenSource

TUNED_ROWS = 1 << 20
"""Rows that a recipe is tuned on; of longer files, evenly spread stretches."""

CHUNK_ROWS = 1 << 18
"""Rows that are cleaned at once: much to do, and little to hold."""

_TUNED_SAMPLES = 1 << 26  # in all channels together


def rows_to_tune_on(channels: int) -> int:
    """Return how many rows tell enough, so that many channels still fit into memory."""
    return min(TUNED_ROWS, max(1 << 16, _TUNED_SAMPLES // max(1, channels)))


def _rows_of_chunks(source: OpenSource) -> int:
    """Return how many rows to clean at once, in whole blocks, so that where a file is cut changes no bit."""
    return max(BLOCK, min(CHUNK_ROWS, block_rows(source.schema)) // BLOCK * BLOCK)


def clean_chunks(
    source: OpenSource, recipe: Recipe, write: Callable[[pa.Table], None], step: Callable[[str, int], None]
) -> tuple[ChannelReport, ...]:
    """Clean a file, and write it; `step` is called after each chunk, with its rows.

    Raises
    ------
    BecalmError
        If the file turns out to be damaged, or cannot be written.
    """
    tables: deque[pa.Table] = deque()
    numbers = [source.names.index(channel.name) for channel in recipe.channel]
    with Cleaner(recipe, source.clock.step_s) as cleaner:
        for chunk in source.chunks(_rows_of_chunks(source)):
            tables.append(chunk.table)
            columns = [chunk.channel(number) for number in numbers]
            for answer in cleaner.push(columns, chunk.elapsed_steps):
                write(_output(tables.popleft(), recipe, answer))
            step("", len(chunk))
        for answer in cleaner.finish():
            write(_output(tables.popleft(), recipe, answer))
        return cleaner.reports()


def _output(table: pa.Table, recipe: Recipe, told: list[Told]) -> pa.Table:
    named = zip(recipe.channel, told, strict=True)
    return output_block(table, {one.name: CleanChannel(clean.signal, clean.sigma, one.unit) for one, clean in named})
