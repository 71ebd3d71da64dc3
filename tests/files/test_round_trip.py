"""What is written of several times reads back as the same groups, and other libraries see it as theirs."""

from __future__ import annotations

import errno
import sys
import time
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np
import pyarrow as pa
import pytest
from asammdf import MDF
from nptdms import TdmsFile
from scipy.io import loadmat

from becalm.cli.times import with_time_column
from becalm.errors import OutputError
from becalm.files import open_output, open_source
from becalm.files.inputs.opening import OpenSource
from becalm.files.outputs.tables import verdict_words
from becalm.files.outputs.writing import write_table
from becalm.files.read_options import ReadOptions
from becalm.files.registry import ENDINGS, format_to_write, stores_several_times
from tables_of_files import Tables

SEVERAL = sorted({form: ending for ending, form in ENDINGS.items() if stores_several_times(form)}.values())
FAST, SLOW = "/imu/acc (raw)", "/imu"
RECIPE = 'name = "ä <&>"\n' + "# long\n" * 20_000
TIMES = np.arange(300) / 128.0
SIGNAL = np.random.default_rng(5).normal(size=300)
VERDICTS = (np.arange(300) % 4).astype(np.int8)


def table(columns: dict[str, Any], units: dict[str, str], **told: str) -> pa.Table:
    made = pa.table(columns)
    fields = [
        field.with_metadata({b"unit": units[field.name].encode()}) if field.name in units else field
        for field in made.schema
    ]
    return made.cast(pa.schema(fields, {f"becalm.{key}": text for key, text in told.items()}))


def fast() -> pa.Table:
    holed = np.where(np.arange(300) == 7, np.nan, SIGNAL)
    columns = {
        "time_s": TIMES,
        "t_ax": SIGNAL / 3,  # no time of `ax`
        "ax": holed,
        "ax_sigma": np.abs(SIGNAL).astype(np.float32),
        "ax_verdict": verdict_words(VERDICTS),
        "count": pa.array([None if row == 3 else row for row in range(300)], pa.int64()),
        "on": pa.array(np.arange(300) % 3 == 0),
    }
    units = {"time_s": "s", "ax": "m/s^2", "ax_sigma": "m/s^2", "t_ax": "°C"}
    return table(columns, units, group=FAST, start="2026-01-02T03:04:05.250000Z")


def slow() -> pa.Table:
    columns = {"time_s": np.arange(6) / 2, "acc": np.arange(6) * 0.1, "note": ["ü", "", "b", "c", "d", "e"]}
    return table(columns, {"time_s": "s", "acc": "bar"}, group=SLOW, start="2026-01-02T03:04:07Z")


def untimed() -> pa.Table:
    return table({"fast/limits": np.arange(300) * 0.5}, {}, group="imu")


def write(path: Path, *written: pa.Table, cut: int = 100) -> Path:
    with open_output(path, {"becalm.recipe": RECIPE}) as out:
        for one in written:
            out.write(one.slice(0, 0))
            out.write(one.slice(0, cut))
            out.write(one.slice(cut))
    return path


def instant(text: str) -> np.datetime64:
    assert text.endswith("Z")
    return np.datetime64(text.removesuffix("Z"), "ns")


@pytest.mark.parametrize("ending", SEVERAL)
def test_groups_come_back_as_they_were(ending: str, tmp_path: Path, tables: Tables) -> None:
    sent = [fast(), slow(), untimed()]
    found = tables(write(tmp_path / f"a{ending}", *sent))
    assert [one.group for one in found] == [FAST, SLOW, "imu"]
    for one, was in zip(found, sent, strict=True):
        assert one.names == was.column_names
        assert one.units == {f.name: f.metadata[b"unit"].decode() for f in was.schema if f.metadata}
        assert one.count == was.num_rows
        block = next(iter(one.blocks(one.names)))
        for name in was.column_names:
            expected = was[name].to_pylist() if is_words(was[name].type) else was[name].to_numpy()
            got = block[name].to_pylist() if is_words(was[name].type) else block[name].to_numpy()
            np.testing.assert_array_equal(got, expected)
            if pa.types.is_floating(was[name].type):
                assert block[name].type == was[name].type
    assert next(iter(found[0].blocks(["on"])))["on"].type == pa.bool_()


def is_words(kind: pa.DataType) -> bool:
    return bool(pa.types.is_string(kind) or pa.types.is_dictionary(kind))


@pytest.mark.parametrize("ending", SEVERAL)
def test_each_group_keeps_its_rate_and_its_first_instant(ending: str, tmp_path: Path, tables: Tables) -> None:
    path = write(tmp_path / f"a{ending}", slow(), fast())
    opened = [OpenSource(path, one, ReadOptions()) for one in tables(path)]
    assert [one.rate_hz for one in opened] == [2.0, 128.0]
    starts = [instant(one.layout.time_start) for one in opened]
    assert starts == [np.datetime64("2026-01-02T03:04:07"), np.datetime64("2026-01-02T03:04:05.250")]


@pytest.mark.parametrize("ending", SEVERAL)
def test_one_group_keeps_its_first_instant_too(ending: str, tmp_path: Path, tables: Tables) -> None:
    told = table({"time_s": TIMES, "a": SIGNAL}, {"time_s": "s"}, start="2026-01-02T03:04:05")
    (found,) = tables(write(tmp_path / f"a{ending}", told))
    assert found.group == ""
    assert found.time is not None
    assert np.datetime64(found.time.start) == np.datetime64("2026-01-02T03:04:05")


@pytest.mark.parametrize("ending", SEVERAL)
def test_what_has_no_instant_gets_none(ending: str, tmp_path: Path, tables: Tables) -> None:
    (found,) = tables(write(tmp_path / f"a{ending}", table({"time_s": TIMES, "a": SIGNAL}, {"time_s": "s"})))
    assert found.time is None or found.time.start == ""


@pytest.mark.parametrize("ending", SEVERAL)
def test_a_group_without_an_instant_gets_none_from_another(ending: str, tmp_path: Path, tables: Tables) -> None:
    other = table({"time_s": TIMES, "other": SIGNAL}, {"time_s": "s"}, group="other")
    found = tables(write(tmp_path / f"a{ending}", other, slow()))
    starts = ["" if one.time is None else one.time.start for one in found]
    assert starts[0] == ""
    assert instant(starts[1]) == np.datetime64("2026-01-02T03:04:07")


@pytest.mark.parametrize("ending", SEVERAL)
def test_what_was_read_back_can_be_written_again(ending: str, tmp_path: Path, tables: Tables) -> None:
    first = tables(write(tmp_path / f"a{ending}", fast(), slow()))
    blocks = [next(iter(one.blocks(one.names))) for one in first]
    for one in first:
        one.rows.close()
    again = tables(write(tmp_path / f"b{ending}", *blocks))
    assert [one.rows.schema for one in again] == [one.rows.schema for one in first]
    for one, block in zip(again, blocks, strict=True):
        for name in block.column_names:
            np.testing.assert_array_equal(next(iter(one.blocks([name])))[name].to_numpy(), block[name].to_numpy())


def test_the_hour_of_writing_changes_no_byte(tmp_path: Path) -> None:
    def contents(name: str) -> dict[str, bytes]:
        return {ending: write(tmp_path / f"{name}{ending}", fast()).read_bytes() for ending in sorted(ENDINGS)}

    first = contents("a")
    time.sleep(2.1)  # archives count in steps of two seconds
    again = contents("a")
    assert [ending for ending in first if first[ending] != again[ending]] == []


def test_asammdf_sees_its_own_kind_of_file(tmp_path: Path) -> None:
    with MDF(write(tmp_path / "a.mf4", fast(), slow())) as log:
        assert log.version == "4.10"
        groups: list[Any] = log.groups
        assert [group.channel_group.acq_name for group in groups] == [FAST, SLOW]
        assert [group.channels[0].name for group in groups] == ["time", "time"]
        assert [channel.name for channel in log.groups[0].channels[1:]] == fast().column_names[1:]
        ax = log.get("ax", group=0)
        assert ax.unit == "m/s^2"
        np.testing.assert_array_equal(ax.samples, fast()["ax"].to_numpy())
        np.testing.assert_array_equal(ax.timestamps, TIMES)
        words = [word.decode() for word in log.get("ax_verdict", group=0).samples]
        assert words == fast()["ax_verdict"].to_pylist()
        np.testing.assert_array_equal(log.get("ax_verdict", group=0, raw=True).samples, VERDICTS)
        np.testing.assert_array_equal(log.get("count", group=0).samples, np.delete(np.arange(300), 3))
        assert log.header.start_time.isoformat() == "2026-01-02T03:04:05.250000+00:00"
        np.testing.assert_array_equal(log.get("acc", group=1).timestamps, 1.75 + np.arange(6) / 2)
        (history,) = log.file_history
    told = ElementTree.fromstring(history.comment)
    assert told.findtext("tool_id") == "becalm"
    assert told.findtext("common_properties/e[@name='becalm.recipe']") == RECIPE


def test_nptdms_sees_its_own_kind_of_file(tmp_path: Path) -> None:
    held = TdmsFile.read(write(tmp_path / "a.tdms", fast(), slow()))
    assert [group.name for group in held.groups()] == [FAST, SLOW]
    assert held.properties["becalm.recipe"] == RECIPE
    ax = held[FAST]["ax"]
    assert ax.properties["unit_string"] == "m/s^2"
    np.testing.assert_array_equal(ax[:], fast()["ax"].to_numpy())
    assert held[FAST]["ax_sigma"].dtype == np.float32
    np.testing.assert_array_equal(held[FAST]["time_s"][:], TIMES)
    assert held[FAST]["on"].dtype == bool
    assert list(held[FAST]["ax_verdict"][:]) == fast()["ax_verdict"].to_pylist()
    count = held[FAST]["count"]
    np.testing.assert_array_equal(np.flatnonzero(count[:] == count.properties["_FillValue"]), [3])
    assert held[SLOW].properties["becalm.start"] == "2026-01-02T03:04:07Z"
    assert list(held[SLOW]["note"][:]) == slow()["note"].to_pylist()


def test_missing_flags_are_refused_where_they_would_be_false(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="'on' has missing flags"):
        write_table(tmp_path / "a.tdms", pa.table({"on": pa.array([True, None, False])}))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", ["tdms", "h5"])
@pytest.mark.parametrize("parts", [[[255, None, 1]], [[255, 2], [None, 1]], [[None, 1], [255, 2]]])
def test_a_number_that_would_stand_for_missing_cells_is_refused(
    ending: str, parts: list[list[int | None]], tmp_path: Path
) -> None:
    def write_parts() -> None:
        with open_output(tmp_path / f"a.{ending}", {}) as out:
            for part in parts:
                out.write(pa.table({"n": pa.array(part, pa.uint8())}))

    with pytest.raises(OutputError, match=r"n' has missing cells and the number 255, .*; write \.parquet"):
        write_parts()
    assert not list(tmp_path.iterdir())
    write_table(tmp_path / f"whole.{ending}", pa.table({"n": pa.array([255, 0, 1], pa.uint8())}))
    write_table(tmp_path / f"holes.{ending}", pa.table({"n": pa.array([254, None, 1], pa.uint8())}))


def test_scipy_numpy_and_h5py_see_groups_as_theirs(tmp_path: Path) -> None:
    held = loadmat(write(tmp_path / "a.mat", fast(), slow()), simplify_cells=True)
    assert held["becalm_recipe"] == RECIPE
    assert held["imu"]["becalm_group"] == SLOW
    np.testing.assert_array_equal(held["imu_acc_raw"]["ax"], fast()["ax"].to_numpy())
    with np.load(write(tmp_path / "a.npz", fast(), slow())) as archive:
        assert archive["becalm_recipe"].item() == RECIPE
        np.testing.assert_array_equal(archive["imu/acc"], slow()["acc"].to_numpy())
        assert archive["imu_acc_raw/ax_verdict"].tolist() == fast()["ax_verdict"].to_pylist()
    with h5py.File(write(tmp_path / "a.h5", fast(), slow())) as file:
        assert file["imu"].attrs["becalm.group"] == SLOW
        np.testing.assert_array_equal(file["imu_acc_raw/ax"], fast()["ax"].to_numpy())


@pytest.mark.parametrize(
    ("name", "column", "seconds"),
    [
        ("t (ms)", np.arange(4) * 250, np.arange(4) / 4),
        ("Time", np.arange(4) / 8, np.arange(4) / 8),
        ("t (days)", np.arange(4) / 86_400, np.arange(4.0)),
        ("timestamp", 1_700_000_000_000 + np.arange(4) * 250, 1_700_000_000 + np.arange(4) / 4),
        ("a", np.arange(4.0), None),
    ],
)
def test_the_master_is_the_time_in_seconds_or_counts_rows(
    name: str, column: Any, seconds: Any, tmp_path: Path, tables: Tables
) -> None:
    write_table(tmp_path / "a.mf4", pa.table({name: column, "b": np.arange(4.0)}))
    with MDF(tmp_path / "a.mf4") as log:
        master: Any = log.groups[0].channels[0]
        assert (master.name, master.sync_type) == (("index", 4) if seconds is None else ("time", 1))
        np.testing.assert_array_equal(log.get_master(0), np.arange(4) if seconds is None else seconds)
        np.testing.assert_array_equal(log.get(name).samples, column)
    (found,) = tables(tmp_path / "a.mf4")
    assert found.names == ([name, "b"] if seconds is None else ["time_s", name, "b"])


@pytest.mark.parametrize(
    ("header", "first", "options"),
    [
        ("millis,x", 500, ReadOptions()),
        ("time,x", 1_700_000_000_000, ReadOptions()),
        ("t,x\nms,m", 500, ReadOptions()),
        ("time_s,x", 0, ReadOptions(rate_hz=100.0)),
    ],
    ids=["name", "epoch", "row of units", "rate"],
)
def test_the_master_of_a_cleaned_file_is_its_own_clock(
    header: str, first: int, options: ReadOptions, tmp_path: Path
) -> None:
    (tmp_path / "a.csv").write_text(header + "\n" + "".join(f"{first + 10 * i},{i * i % 7}\n" for i in range(9)))
    with open_source(tmp_path / "a.csv", options) as source, open_output(tmp_path / "a.mf4") as out:
        write_rows = with_time_column(tmp_path / "a.mf4", source, out.write)
        for chunk in source.chunks(4):
            write_rows(chunk.table)
    with MDF(tmp_path / "a.mf4") as log:
        begin = first / 1000 if first < 1000 else 0.0
        np.testing.assert_allclose(log.get_master(0), begin + np.arange(9) / 100, atol=1e-12)


@pytest.mark.parametrize("ending", ["h5", "mf4", "tdms"])
def test_long_whole_numbers_beside_a_missing_one_keep_their_digits(ending: str, tmp_path: Path, tables: Tables) -> None:
    ids = [2**60 + 1, None, 2**60 + 3]
    path = tmp_path / f"a.{ending}"
    write_table(path, pa.table({"time_s": [0.0, 0.1, 0.2], "id": pa.array(ids, pa.int64()), "x": [1.5, 2.5, 0.5]}))
    (found,) = tables(path)
    assert next(iter(found.blocks(["id"])))["id"].to_pylist() == ids


def test_words_that_come_late_are_told_too(tmp_path: Path, tables: Tables) -> None:
    words = [pa.array(texts).dictionary_encode() for texts in (["a", None], ["späte", "a"])]
    with open_output(tmp_path / "a.mf4") as out:
        for number, column in enumerate(words):
            out.write(pa.table({"time_s": pa.array([2.0 * number, 2.0 * number + 1]), "w": column}))
    (found,) = tables(tmp_path / "a.mf4")
    assert next(iter(found.blocks(["w"])))["w"].to_pylist() == ["a", "", "späte", "a"]


def test_an_mf4_file_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def fail_midway() -> None:
        with open_output(tmp_path / "a.mf4") as out:
            out.write(fast())
            raise RuntimeError("midway")

    with pytest.raises(RuntimeError, match="midway"):
        fail_midway()
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_told_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(MDF, "save", full, raising=False)
    with pytest.raises(OutputError, match="is full"):
        write_table(tmp_path / "a.mf4", fast())
    assert not list(tmp_path.iterdir())


def test_without_asammdf_a_sentence_says_what_brings_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(OutputError, match=r"asammdf.*pip install 'becalm\[formats\]'"):
        write_table(tmp_path / "a.mf4", fast())
    assert not list(tmp_path.iterdir())


def test_version_3_is_refused() -> None:
    with pytest.raises(OutputError, match=r"but version 4 is written: end the name in \.mf4"):
        format_to_write(Path("a.mdf"))
