"""Streams to keep: rows whose numbers tell their row, and a journal of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Integers
from becalm.live.address import Address
from becalm.live.block import Checkpoint, Head, Loss, Output
from becalm.live.journal.journal import Journal
from becalm.live.journal.reading import open_journal

RECIPE = "recipe = 1\n"
HEAD = Head(("ax", "strain (um/m)"), ("m/s^2", "um/m"), 10.0, RECIPE)
EPOCH_S = 1_700_000_000.0  # 2023-11-14 22:13:20 UTC
SOURCE = "replay:drive.csv"


def rows_of(first: int, count: int, start_s: float = EPOCH_S, losses: tuple[Loss, ...] = ()) -> Output:
    """Make rows at 10 Hz; each channel tells the row, and some readings are missing or infinite."""
    row = np.arange(first, first + count)
    signal = np.column_stack([row + 0.25, -1.0 * row])
    values = signal + 0.5
    values[row % 7 == 3, 0] = np.nan
    values[row % 11 == 5, 1] = -np.inf
    verdicts = np.where(np.isnan(values), 1, np.where(np.isinf(values), 2, 0)).astype(np.int8)
    return Output(first, start_s + row / 10, values, signal, np.full((count, 2), 0.125), verdicts, losses)


def checkpoint_at(rows: int, recipe: str = RECIPE) -> Checkpoint:
    """Return where a stream stands after so many rows."""
    return Checkpoint(rows, f'{{"row": {rows}}}', f"filters after {rows}".encode() * 20, recipe, SOURCE)


@contextmanager
def journal_in(folder: Path, options: str = "", head: Head = HEAD) -> Iterator[Journal]:
    """Open a journal to keep a stream."""
    journal = Journal(Address.parsed(f"journal:{folder}{options}"))
    try:
        journal.last()
        journal.open(head)
        yield journal
    finally:
        journal.close()


def fill(journal: Journal, blocks: int, rows: int = 100, start_s: float = EPOCH_S) -> int:
    """Keep some blocks more, and return how many rows there are then."""
    checkpoint = journal.last()
    row = 0 if checkpoint is None else checkpoint.rows
    for _ in range(blocks):
        journal.commit([rows_of(row, rows, start_s)], checkpoint_at(row + rows))
        row += rows
    return row


def table_of(folder: Path) -> pa.Table:
    """Read all rows of a journal that has some."""
    with open_journal(folder) as journal:
        return pa.concat_tables([table.replace_schema_metadata(None) for table in journal.tables()])


def assert_rows(folder: Path, rows: int, start_s: float = EPOCH_S, lost: Sequence[int] | Integers = ()) -> None:
    """Fail unless a journal holds each row once, in order and to the bit, but those that are lost."""
    table = table_of(folder)
    found = table["row"].to_numpy()
    np.testing.assert_array_equal(found, np.delete(np.arange(rows), np.asarray(lost, np.int64)))
    expected = rows_of(0, rows, start_s)
    parts = {"": expected.signal, "_raw": expected.values, "_sigma": expected.sigma}
    assert table["time_s"].to_numpy().tobytes() == expected.time_s[found].tobytes()
    for channel, name in enumerate(HEAD.names):
        for ending, part in parts.items():
            assert table[name + ending].to_numpy().tobytes() == part[found, channel].tobytes()
