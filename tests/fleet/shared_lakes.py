"""Lakes whose files hold several sensors each, for tests of jobs that tell them apart by a column."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from becalm.core.arrays import Integers
from made import table_of, walk

KEY = "sensor"


def own_table(seed: int, rows: int) -> pa.Table:
    """Return the rows of one sensor in the order of time: two channels in metres, with holes, and a text."""
    return table_of(np.arange(rows) / 100, a=walk(seed, rows, holes=2), b=walk(seed + 100, rows))


def keyed(table: pa.Table, key: pa.Scalar | str | float | None, name: str = KEY) -> pa.Table:
    """Return a table with a first column that tells of which sensor its rows are."""
    return table.add_column(0, name, pa.array([key] * table.num_rows, None if key is not None else pa.string()))


def together(tables: Sequence[pa.Table], order: Integers | None = None) -> pa.Table:
    """Return the rows of several sensors as one table: in the order of time, or any other."""
    table = pa.concat_tables(tables, promote_options="default")
    return table.sort_by("time_s") if order is None else table.take(order)


def shuffled(tables: Sequence[pa.Table], seed: int = 5) -> pa.Table:
    """Return the rows of several sensors in no order."""
    return together(tables, np.random.default_rng(seed).permutation(sum(table.num_rows for table in tables)))


def write_files(folder: Path, table: pa.Table, files: int = 3, **how: Any) -> Path:
    """Write a table into several files of about as many rows."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, (first, stop) in enumerate(pairwise(np.linspace(0, table.num_rows, files + 1).astype(int).tolist())):
        pq.write_table(table.slice(first, stop - first), folder / f"part-{number}.parquet", **how)
    return folder
