"""Streams for sinks: what a runner would hand them, with readings of every kind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from becalm.live.block import Checkpoint, Head, Output


def head_of(*names: str, recipe: str = "version = 1\n") -> Head:
    """Return a head of channels in metres."""
    return Head(names, ("m",) * len(names), 1000.0, recipe)


def outputs_of(sizes: Sequence[int], channels: int = 1, first_row: int = 0, begins_s: float = 0.0) -> list[Output]:
    """Return outputs of so many rows each, the same for the same rows, with NaN and infinity among the readings."""
    made = []
    for size in sizes:
        rows = np.arange(first_row, first_row + size)
        readings = np.sin(rows[:, None] * 0.1 + np.arange(channels)) / 3.0
        readings[rows % 7 == 1] = np.nan
        readings[rows % 11 == 2] = np.inf
        verdicts = np.where(rows % 7 == 1, 1, np.where(rows % 11 == 2, 4, 0)).astype(np.int8)
        made.append(
            Output(
                first_row,
                begins_s + rows / 1000.0,
                readings,
                np.cos(rows[:, None] * 0.1 + np.arange(channels)) / 3.0,
                np.full((size, channels), 0.1),
                np.repeat(verdicts[:, None], channels, axis=1),
            )
        )
        first_row += size
    return made


def assert_same_bits(found: pa.Table, written: pa.Table) -> None:
    """Check that two tables of rows hold the same columns, numbers to the bit."""
    assert found.column_names == written.column_names
    for name in written.column_names:
        if name.endswith("_verdict"):
            assert found[name].to_pylist() == written[name].to_pylist()
        else:
            ours, theirs = written[name].to_numpy(), found[name].to_numpy()
            np.testing.assert_array_equal(ours.view(np.int64), theirs.view(np.int64))


def checkpoint_at(rows: int, recipe: str = "version = 1\n") -> Checkpoint:
    """Return where a stream stands after so many rows."""
    return Checkpoint(rows, f'{{"line": {rows}}}', f"filters after {rows}".encode(), recipe, "replay:made.csv")
