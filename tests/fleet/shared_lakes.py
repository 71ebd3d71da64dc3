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
from becalm.fleet.batch import BatchOptions, Fleet, clean
from becalm.fleet.recipes import open_book
from made import Lake, Run, table_of, walk

KEY = "sensor"
SPARK: Any = None
BY_SENSOR = BatchOptions(by=KEY)


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


def cleaned(lake: Lake, asked: BatchOptions = BY_SENSOR) -> Fleet:
    """Clean a lake into the folder beside it."""
    return clean(SPARK, lake.root, lake.root.parent / "out", open_book(lake.recipe), asked)


def states(fleet: Fleet) -> dict[str, str]:
    """Return what became of each sensor."""
    return {one.sensor: one.state for one in fleet.outcomes}


def read_again(*_: object) -> None:
    """Stand in for what must not be called."""
    raise AssertionError("samples were read")


def as_a_file(run: Run, lake: Lake, table: pa.Table) -> pa.Table:
    """Clean a sensor's own rows as `becalm clean` does."""
    own, out = lake.root.parent / "own.parquet", lake.root.parent / "one.parquet"
    pq.write_table(table, own)
    ran = run("clean", own, "-o", out, "--recipe", lake.recipe, "--verdicts")
    assert ran.returncode in (0, 4), ran.stderr
    return pq.read_table(out)
