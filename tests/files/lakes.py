"""Tables cut into the files of a folder, for tests of folders."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

START_MS = 1_646_697_599_000  # 2022-03-07 23:59:59, one second before midnight


def readings(count: int = 300) -> dict[str, pa.Array]:
    """Return two channels and a column of words: a walk, and one with NaN, nulls and -0.0."""
    rng = np.random.default_rng(8)
    walk = np.cumsum(rng.normal(size=count))
    holed = [None if k % 7 == 3 else [np.nan, -0.0, float(walk[k])][k % 3] for k in range(count)]
    words = pa.array([None if k % 5 == 0 else f"gear {k // 9}" for k in range(count)], pa.string())
    return {"walk": pa.array(walk), "holed": pa.array(holed, pa.float64()), "words": words}


def evenly(count: int = 300) -> pa.Table:
    """Return a table at 100 Hz with its time in seconds."""
    return pa.table({"time_s": np.arange(count) / 100, **readings(count)})


def cut(table: pa.Table, ends: Iterable[int], names: Sequence[str], folder: Path) -> Path:
    """Write the rows up to each end as a file of its own, those after the last as well."""
    edges = [0, *ends, table.num_rows]
    for (start, stop), name in zip(pairwise(edges), names, strict=True):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table.slice(start, stop - start), path, row_group_size=50)
    return folder


def spark_log(root: Path, batches: Mapping[str, Sequence[str]], written_to: str = "/far/off") -> None:
    """Write the log of a stream: which files each batch committed, by their paths from the root."""
    (root / "_spark_metadata").mkdir(parents=True)
    for name, files in batches.items():
        lines = [
            json.dumps({"path": "file://" + quote(f"{written_to}/{file}"), "size": 1, "isDir": False, "action": "add"})
            for file in files
        ]
        (root / "_spark_metadata" / name).write_text("\n".join(["v1", *lines]), encoding="utf-8")
