"""A file that changes while it is read is refused: two files are never mixed."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.errors import InputError
from becalm.files import open_source, registry
from becalm.files.csv.reader import read_csv
from becalm.files.source import RawTable

CHANGED = "log.* changed while it was read; wait until it is complete, and repeat"


def write(path: Path, **columns: float) -> None:
    count = 5000
    noise = np.random.default_rng(2).normal(size=count)
    table = {name: noise * factor for name, factor in columns.items()}
    pq.write_table(pa.table({"time_s": np.arange(count) / 100, **table}), path, row_group_size=500)


@pytest.mark.parametrize("columns", [{"a": 2.0}, {"b": 1.0, "c": 1.0}, {"a": 1.0, "b": 1.0}], ids=lambda c: "".join(c))
@pytest.mark.parametrize("in_place", [False, True])
def test_parquet_that_is_replaced_is_refused(columns: dict[str, float], in_place: bool, tmp_path: Path) -> None:
    path, other = tmp_path / "log.parquet", tmp_path / "other.parquet"
    write(path, a=1.0)
    write(other, **columns)
    with open_source(path) as source:
        chunks = source.chunks(1000)
        next(chunks)
        if in_place:
            path.write_bytes(other.read_bytes())
        else:
            other.replace(path)
        with pytest.raises(InputError, match=CHANGED):
            list(chunks)
        with pytest.raises(InputError, match=CHANGED):
            source.recording()
        with pytest.raises(InputError, match=CHANGED):
            source.sha256()


def test_parquet_that_is_gone_or_cut_off_is_not_called_damaged(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    write(path, a=1.0)
    with open_source(path) as source:
        path.write_bytes(path.read_bytes()[:300])
        with pytest.raises(InputError, match=CHANGED):
            source.recording()
        path.unlink()
        with pytest.raises(InputError, match=CHANGED):
            source.recording()


@pytest.mark.parametrize("end", ["50.00,1.5\n", "50"], ids=["a row more", "half a row more"])
def test_csv_that_grows_while_it_is_read_is_refused(end: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,a\n" + "".join(f"{i / 100},{i % 7}.5\n" for i in range(300)), encoding="utf-8")

    def read_late(late: Path, data: bytes) -> RawTable:
        with path.open("a", encoding="utf-8") as file:
            file.write(end)
        return read_csv(late, late.read_bytes() if data else data)

    monkeypatch.setattr(registry, "read_csv", read_late)
    with pytest.raises(InputError, match=CHANGED):
        open_source(path)


def test_csv_that_grows_before_the_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time_s,a\n" + "".join(f"{i / 100},{i % 7}.5\n" for i in range(300)), encoding="utf-8")
    with open_source(path) as source:
        assert source.sha256() == hashlib.sha256(path.read_bytes()).hexdigest()
        assert sum(len(chunk) for chunk in source.chunks()) == 300
        path.write_text(path.read_text(encoding="utf-8") + "3.00,1.5\n", encoding="utf-8")
        with pytest.raises(InputError, match=CHANGED):
            list(source.chunks())
