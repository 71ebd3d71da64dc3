"""Only committed files of a folder are read, where an engine keeps a log of what it committed."""

from __future__ import annotations

import json
import shutil
import struct
import sys
from pathlib import Path

import deltalake
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import becalm
from becalm.errors import InputError
from becalm.files import read_source
from becalm.files.lake.listing import parquet_files
from lakes import cut, evenly, spark_log

NAMES = [f"sensor=a b/date={day}/part-{day}é%20.parquet" for day in (1, 2, 3)]


def stream(root: Path, batches: dict[str, list[str]] | None = None) -> Path:
    """Write what a stream of Spark leaves: three files, of which the last is an orphan unless the log names it."""
    cut(evenly(), [100, 200], NAMES, root)
    spark_log(root, {"0": NAMES[:1], "1": NAMES[1:2]} if batches is None else batches)
    return root


@pytest.mark.parametrize("given", ["", "sensor=a b", "sensor=a b/"])
def test_an_orphan_of_a_killed_job_is_not_read(given: str, tmp_path: Path) -> None:
    folder = stream(tmp_path / "out") / given
    source = read_source(folder)
    assert source.table.select(["time_s", "words"]) == evenly().slice(0, 200).select(["time_s", "words"])
    (note,) = source.layout.notes
    assert f"One file is left out that the log of {tmp_path / 'out'} does not name, such as part-3é%20.parquet:" in note
    assert len(becalm.read(folder / "date=2" if given else folder / "sensor=a b/date=2")) == 100
    with pytest.raises(InputError, match=r"holds no Parquet file that the log of \S*/out names"):
        becalm.read(tmp_path / "out" / "sensor=a b" / "date=3")


def test_a_folder_that_is_no_partition_is_not_of_the_log_above(tmp_path: Path) -> None:
    root = stream(tmp_path / "out")
    cut(evenly(), [], ["mine.parquet"], root / "by hand")
    assert len(becalm.read(root / "by hand")) == 300
    assert len(becalm.read(root)) == 200


@pytest.mark.parametrize(
    ("batches", "counted"),
    [
        ({"0": NAMES[:1], "1": [], "2.compact": NAMES[:2], "3": NAMES[2:]}, 300),
        ({"0": NAMES[:1], "1": NAMES[1:2], "2.compact": NAMES[1:2]}, 100),  # what it no longer names was left out since
        ({"11.compact": NAMES[:1], "2.compact": NAMES, "12": NAMES[1:2]}, 200),
        ({"2.compact": NAMES[:2], ".3.crc": NAMES[2:], "3.tmp": NAMES[2:]}, 200),
        ({str(number): NAMES[2:] if number == 10 else NAMES[:1] for number in range(11)}, 200),
    ],
)
def test_batches_are_read_from_the_last_that_holds_all(
    batches: dict[str, list[str]], counted: int, tmp_path: Path
) -> None:
    assert sum(pq.read_metadata(path).num_rows for path in parquet_files(stream(tmp_path / "o", batches)).files) == (
        counted
    )


def test_a_file_that_was_deleted_in_the_log_is_not_read(tmp_path: Path) -> None:
    root = stream(tmp_path / "out")
    batch = root / "_spark_metadata" / "1"
    batch.write_text(batch.read_text(encoding="utf-8").replace('"add"', '"delete"'), encoding="utf-8")
    (root / "_spark_metadata" / "2").write_text((root / "_spark_metadata" / "0").read_text(encoding="utf-8"))
    assert len(becalm.read(root)) == 100


def test_a_stream_inside_of_a_folder_has_its_own_log(tmp_path: Path) -> None:
    stream(tmp_path / "lake" / "date=2026-01")
    (tmp_path / "lake" / "sensor=a b").mkdir()
    pq.write_table(evenly().slice(200), tmp_path / "lake" / "sensor=a b" / "rest.parquet")
    assert becalm.read(tmp_path / "lake").samples.shape == (300, 2)


def test_files_that_are_named_and_not_there_are_told(tmp_path: Path) -> None:
    root = stream(tmp_path / "out", {"0": NAMES, "1": ["sensor=b/part-9.parquet"]})
    (root / NAMES[1]).unlink()
    source = read_source(root)
    assert source.layout.gaps == 1
    (note,) = source.layout.notes
    assert note.startswith(f"2 files are missing that the log of {root} names, such as {NAMES[1]}: the rows")
    (note,) = read_source(root / "sensor=a b").layout.notes
    assert note.startswith(f"One file is missing that the log of {root} names, such as {NAMES[1]}:")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("0", "v2\n", r"_spark_metadata/0 begins with 'v2'; the log of a stream begins with 'v1'"),
        ("0", "", r"_spark_metadata/0 is empty"),
        ("1", 'v1\n{"path":"file:///a', r"_spark_metadata/1 is damaged: '\{\"path"),
        ("1", "v1\n[]", r"_spark_metadata/1 is damaged"),
        ("1", 'v1\n{"path":3,"action":"add"}', r"_spark_metadata/1 is damaged"),
        ("3", "v1", r"_spark_metadata lacks the batch 2"),
        ("3.compact", "v1\nx", r"3\.compact is damaged"),
        ("5", "v1", r"_spark_metadata lacks the batch 2"),
    ],
)
def test_a_damaged_log_is_refused(name: str, text: str, said: str, tmp_path: Path) -> None:
    root = stream(tmp_path / "out")
    (root / "_spark_metadata" / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        becalm.read(root)


def test_a_log_without_batches_has_committed_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no Parquet file that the log"):
        becalm.read(stream(tmp_path / "out", {}))


def test_of_a_finished_output_only_marked_files_are_read(tmp_path: Path) -> None:
    """As where another run had more of them, and was killed before it could take them away."""
    folder = cut(evenly(), [100, 200], ["b.parquet", "date=1/é a.parquet", "old.parquet"], tmp_path / "sensor=1")
    (folder / "_becalm.json").write_text(json.dumps({"files": ["b.parquet", "date=1/é a.parquet"]}), encoding="utf-8")
    assert len(becalm.read(folder)) == 200
    assert len(becalm.read(folder / "date=1")) == 100
    shutil.copy(folder / "date=1" / "é a.parquet", folder / "é a.parquet")  # of the name of one that counts
    assert len(becalm.read(folder)) == 200
    (folder / "_becalm.json").write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match=r"_becalm\.json is damaged: it does not list"):
        becalm.read(folder)


def delta(root: Path) -> Path:
    """Write a Delta table of one sensor, whose first rows were written twice: the first of them live in no file now."""
    rows = evenly().append_column("sensor", pa.array(["a b"] * 300))
    old = rows.slice(0, 100).set_column(1, "walk", pa.array([9e9] * 100))
    deltalake.write_deltalake(root, old, partition_by=["sensor"])
    deltalake.write_deltalake(root, rows.slice(0, 200), mode="overwrite")
    deltalake.write_deltalake(root, rows.slice(200), mode="append")
    return root


@pytest.mark.parametrize("given", ["", "sensor=a%20b"])
def test_of_a_delta_table_what_lives_is_read(given: str, tmp_path: Path) -> None:
    folder = shutil.move(delta(tmp_path / "written"), tmp_path / "a table")
    source = read_source(Path(folder) / given)
    assert source.recording.channel("walk").tobytes() == evenly()["walk"].to_numpy().tobytes()
    assert source.table.column_names == ["time_s", "walk", "holed", "words"]
    (note,) = source.layout.notes
    assert "One file is left out that the log of" in note


def test_folders_of_a_delta_table_are_called_as_its_log_says(tmp_path: Path) -> None:
    """As Spark writes it: a blank is a blank in the folder, and %20 in the log."""
    root = delta(tmp_path / "t")
    (root / "sensor=a%20b").rename(root / "sensor=a b")
    for commit in (root / "_delta_log").glob("*.json"):
        commit.write_text(commit.read_text(encoding="utf-8").replace("a%2520b", "a%20b"), encoding="utf-8")
    assert len(becalm.read(root / "sensor=a b")) == 300


def test_a_delta_table_needs_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = delta(tmp_path)
    monkeypatch.setitem(sys.modules, "deltalake", None)
    with pytest.raises(InputError, match=r"is a Delta table, .*pip install 'becalm\[delta\]'"):
        becalm.read(root)


def test_a_damaged_delta_log_is_refused(tmp_path: Path) -> None:
    root = delta(tmp_path)
    (root / "_delta_log" / f"{1:020d}.json").write_text("{", encoding="utf-8")
    with pytest.raises(InputError, match="is a damaged Delta table"):
        becalm.read(root)


def commit(root: Path, *actions: dict[str, object]) -> None:
    """Add a commit to the log of a Delta table."""
    log = sorted((root / "_delta_log").glob("*.json"))
    text = "\n".join(json.dumps(action) for action in actions)
    (root / "_delta_log" / f"{len(log):020d}.json").write_text(text, encoding="utf-8")


def deletion_vector(row: int) -> dict[str, object]:
    """Return what the log of a Delta table says of a file in which one row is deleted."""
    rows = struct.pack("<IIHHIH", 12346, 1, 0, 0, 16, row)  # a roaring bitmap of one container with one number
    packed = struct.pack("<iQI", 1681511377, 1, 0) + rows
    packed += bytes(-len(packed) % 4)
    digits = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ.-:+=^!/*?&<>()[]{}@%$#"
    text = "".join(digits[word // 85**k % 85] for (word,) in struct.iter_unpack(">I", packed) for k in range(4, -1, -1))
    return {"storageType": "i", "pathOrInlineDv": text, "sizeInBytes": 34, "cardinality": 1}


def test_rows_of_a_delta_table_that_are_deleted_in_its_log_alone_are_refused(tmp_path: Path) -> None:
    deltalake.write_deltalake(tmp_path, evenly())
    first = (tmp_path / "_delta_log" / f"{0:020d}.json").read_text(encoding="utf-8").splitlines()
    (add,) = [told["add"] for told in map(json.loads, first) if "add" in told]
    features = {"readerFeatures": ["deletionVectors"], "writerFeatures": ["deletionVectors"]}
    commit(tmp_path, {"protocol": {"minReaderVersion": 3, "minWriterVersion": 7, **features}})
    assert len(becalm.read(tmp_path)) == 300
    removed = {"path": add["path"], "deletionTimestamp": 1, "dataChange": True}
    commit(tmp_path, {"remove": removed}, {"add": {**add, "deletionVector": deletion_vector(7)}})
    (masks,) = deltalake.DeltaTable(tmp_path).deletion_vectors()
    assert [row for row, kept in enumerate(masks.column("selection_vector").to_pylist()[0]) if not kept] == [7]
    with pytest.raises(InputError, match="Delta table with deleted rows"):
        becalm.read(tmp_path)


def test_columns_of_a_delta_table_that_have_other_names_in_its_log_are_refused(tmp_path: Path) -> None:
    deltalake.write_deltalake(tmp_path, evenly())
    first = (tmp_path / "_delta_log" / f"{0:020d}.json").read_text(encoding="utf-8").splitlines()
    (told,) = [told["metaData"] for told in map(json.loads, first) if "metaData" in told]
    commit(tmp_path, {"metaData": {**told, "configuration": {"delta.columnMapping.mode": "name"}}})
    with pytest.raises(InputError, match="Delta table with mapped column names"):
        becalm.read(tmp_path)
