"""Compare two outputs of a fleet's sensor row by row, whatever files they are split into."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fleet_lakes import GROUP


class Compared(NamedTuple):
    """The comparison of two outputs of a sensor."""

    rows: int
    differ: int  # count of numbers that are not bitwise equal, and of blocks with different verdicts
    apart: float  # largest difference of two clean values, relative to the largest value


def compared(one: Path, other: Path) -> Compared:
    """Compare every row of two outputs of a sensor."""
    rows, differ, apart, largest = 0, 0, 0.0, 0.0
    for first, second in zip(_batches(one), _batches(other), strict=True):
        rows += first.num_rows
        for name in ("time (s)", "x", "x_sigma"):
            a, b = first.column(name).to_numpy(), second.column(name).to_numpy()
            differ += int(np.count_nonzero(a.view(np.int64) != b.view(np.int64)))
            if name == "x":
                assert np.array_equal(np.isnan(a), np.isnan(b))
                apart, largest = max(apart, np.nanmax(np.abs(a - b))), max(largest, np.nanmax(np.abs(b)))
        a, b = (table.column("x_verdict").cast(pa.string()) for table in (first, second))
        differ += 0 if a.equals(b) else 1
    return Compared(rows, differ, float(apart / largest))


def _batches(folder: Path) -> Iterator[pa.Table]:
    """Yield the rows of an output in the order of time, a million at a time, whatever files they are in."""
    files = [pq.ParquetFile(path) for path in folder.rglob("*.parquet")]
    files.sort(key=lambda file: float(file.read_row_group(0, ["time (s)"])[0][0].as_py()))
    held: list[pa.Table] = []
    for file in files:
        for batch in file.iter_batches(GROUP):
            held.append(pa.Table.from_batches([batch]).unify_dictionaries())
            while sum(table.num_rows for table in held) >= GROUP:
                joined = pa.concat_tables(held)
                yield joined.slice(0, GROUP).combine_chunks()
                held = [joined.slice(GROUP)]
    if held:
        yield pa.concat_tables(held).combine_chunks()
