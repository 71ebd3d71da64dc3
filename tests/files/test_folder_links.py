"""Links in a folder of Parquet files: what they lead to is read once, under its own name."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest

import becalm
from becalm.errors import InputError
from becalm.files.lake.listing import parquet_files
from lakes import cut, evenly

COUNT = 300


def test_a_linked_folder_is_read_once(tmp_path: Path) -> None:
    cut(evenly(), [100], ["a.parquet", "b.parquet"], tmp_path / "elsewhere")
    (tmp_path / "lake").mkdir()
    (tmp_path / "lake" / "one").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "again").symlink_to(tmp_path / "lake")
    assert len(becalm.read(tmp_path / "lake")) == COUNT
    (tmp_path / "lake" / "gone.parquet").symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"gone\.parquet does not exist"):
        becalm.read(tmp_path / "lake")


def test_a_linked_file_is_read_once(tmp_path: Path) -> None:
    folder = cut(evenly(), [100], ["b.parquet", "c.parquet"], tmp_path / "lake")
    (folder / "a.parquet").symlink_to(folder / "b.parquet")
    pq.write_table(evenly().slice(0, 0), tmp_path / "elsewhere.parquet")
    (folder / "d.parquet").symlink_to(tmp_path / "elsewhere.parquet")
    (folder / "e.parquet").symlink_to(folder / "d.parquet")
    assert len(becalm.read(folder)) == COUNT
    assert [path.name for path in parquet_files(folder).files] == ["b.parquet", "c.parquet", "d.parquet"]
