"""MDF: masters, conversions applied once, invalid samples, bus logs with their DBC; what is not read is said."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pytest
from asammdf import MDF, Source
from asammdf.blocks.v4_constants import FLAG_CG_BUS_EVENT, FLAG_CG_PLAIN_BUS_EVENT

import becalm
from becalm.errors import InputError
from becalm.files import ReadOptions, open_source
from mdf_logs import ROWS, SIGNAL, signal, written
from robot_logs import by_name
from tables_of_files import Tables

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "css_mf4"
LOG = "00000003-60FEBB3B.MF4"


def real(name: str) -> Path:
    if not (DATA / name).exists():
        pytest.skip(f"the recordings are not beside the project ({name})")
    return DATA / name


def test_the_real_log_is_decoded_by_the_database_beside_it() -> None:
    path = real(LOG)
    with (
        MDF(path) as log,
        log.extract_bus_logging(database_files={"CAN": [(str(DATA / "canmod-gps.dbc"), 0)]}) as decoded,
        open_source(path, ReadOptions(group="gnss_imu")) as source,
    ):
        recording = source.recording()
        assert source.rows == 60788
        assert source.rate_hz == pytest.approx(100, abs=0.1)
        assert recording.names == tuple(f"{kind}{axis}" for kind in ("Acceleration", "AngularRate") for axis in "XYZ")
        assert recording.units == ("m/s^2",) * 3 + ("deg/s",) * 3
        for name in recording.names:
            theirs = decoded.get(name)
            np.testing.assert_array_equal(recording.channel(name), theirs.samples)
        np.testing.assert_allclose(recording.times_s, theirs.timestamps - theirs.timestamps[0], rtol=0, atol=1e-9)
        assert source.table()["ImuValid"].to_pylist()[:2] == ["Valid", "Valid"]


def test_all_messages_of_the_real_log_are_groups(tables: Tables) -> None:
    found = {table.group: table for table in tables(real(LOG))}
    assert list(found) == [
        f"gnss_{name}" for name in ("status", "time", "pos", "altitude", "attitude", "odo", "speed", "geofence", "imu")
    ]
    assert found["gnss_speed"].units["Speed"] == "m/s"
    assert found["gnss_speed"].time
    assert found["gnss_speed"].time.start == "2021-07-26T13:30:00.529000Z"


def test_a_bus_log_without_its_database(tmp_path: Path) -> None:
    shutil.copy(real(LOG), tmp_path / LOG)
    with pytest.raises(InputError, match=r"put the \.dbc file that describes its frames into the same folder"):
        becalm.read(tmp_path / LOG)
    (tmp_path / "other.dbc").write_text('VERSION ""\nBO_ 77 Other: 8 X\n SG_ a : 0|8@1+ (1,0) [0|0] "" X\n')
    with pytest.raises(InputError, match=r"frames other\.dbc does not describe"):
        becalm.read(tmp_path / LOG)
    (tmp_path / "other.dbc").write_bytes(bytes(range(256)))
    with pytest.raises(InputError):
        becalm.read(tmp_path / LOG)


def test_frames_of_a_bus_are_decoded_by_a_database_beside_them(tmp_path: Path) -> None:
    counts = np.arange(ROWS, dtype=np.uint16) * 300
    parts: list[tuple[str, Any, Any]] = [("BusChannel", "u1", 1), ("ID", "<u4", 0x123), ("IDE", "u1", 0)]
    parts += [("DLC", "u1", 8), ("DataLength", "u1", 8), ("DataBytes", "(8,)u1", 0), ("Dir", "u1", 0)]
    frames = np.zeros(ROWS, [(f"CAN_DataFrame.{name}", kind) for name, kind, _ in parts])
    for name, _, value in parts:
        frames[f"CAN_DataFrame.{name}"] = value
    frames["CAN_DataFrame.DataBytes"][:, :2] = counts.view("u1").reshape(-1, 2)
    path = tmp_path / "bus.mf4"
    with MDF(version="4.11") as log:
        log.append(signal("CAN_DataFrame", frames, source=Source("CAN1", "CAN1", "", 2, 2)))
        log.groups[0].channel_group.flags = FLAG_CG_BUS_EVENT | FLAG_CG_PLAIN_BUS_EVENT  # type: ignore[union-attr]
        log.save(path)
    with pytest.raises(InputError, match=r"put the \.dbc file that describes its frames into the same folder"):
        becalm.read(path)
    (tmp_path / "car.dbc").write_text(
        'VERSION ""\nBO_ 291 Motion: 8 X\n SG_ Speed : 0|16@1+ (0.01,-5) [0|655] "km/h" X\n'
    )
    recording = becalm.read(path)
    assert (recording.names, recording.units) == (("Speed",), ("km/h",))
    assert recording.rate_hz == pytest.approx(50)
    np.testing.assert_allclose(recording.samples[:, 0], counts * 0.01 - 5, atol=1e-12)


def test_the_real_log_cut(tmp_path: Path) -> None:
    path, names = real(LOG), ["time_s", "AccelerationX", "AngularRateZ"]
    shutil.copy(DATA / "canmod-gps.dbc", tmp_path)
    data = path.read_bytes()
    whole = pa.concat_tables(list(by_name(path)["gnss_imu"].blocks(names)))
    for percent in (70, 80, 90, 99):
        (tmp_path / LOG).write_bytes(data[: len(data) * percent // 100])
        cut = by_name(tmp_path / LOG)["gnss_imu"]
        assert 1000 < cut.count < whole.num_rows
        assert "incomplete" in cut.notes[-1]
        read = pa.concat_tables(list(cut.blocks(names)))
        assert read.slice(0, cut.count).equals(whole.slice(0, cut.count))


@pytest.mark.parametrize("version", ["2.14", "3.30", "4.00", "4.10", "4.20"])
def test_values_units_and_times_of_every_version(version: str, tmp_path: Path, tables: Tables) -> None:
    counts = np.arange(ROWS, dtype=np.int16)
    path = written(
        tmp_path,
        [signal("force", counts, unit="kN", conversion={"a": 0.5, "b": -3.0}), signal("a", SIGNAL, unit="m/s\u00b2")],
        version=version,
    )
    read = becalm.read(path)
    np.testing.assert_array_equal(read.samples, np.stack([counts * 0.5 - 3, SIGNAL], axis=1))
    assert (read.names, read.units) == (("force", "a"), ("kN", "m/s^2"))
    assert read.timebase.uniform
    assert read.rate_hz == pytest.approx(50)
    (table,) = tables(path)
    assert table.time
    assert table.time.start == "2024-03-01T12:31:40Z"


def test_masters_stay_apart_and_names_differ(tmp_path: Path, tables: Tables) -> None:
    slow = np.arange(7) / 4
    path = written(
        tmp_path,
        [signal("a", SIGNAL), signal("a", 2 * SIGNAL), signal("time_s", SIGNAL), signal("\u00e4 \u4e2d", SIGNAL)],
        [signal("a", slow, t=slow), signal("b", slow, t=slow)],
        [signal("one", [1.0], t=np.array([0.5]))],
        [signal("none", [], t=np.empty(0))],
    )
    found = tables(path)
    assert [(table.group, table.count) for table in found] == [("group 0", ROWS), ("group 1", 7), ("group 2", 1)]
    assert found[0].names == ["time_s", "group 0/a", "a_2", "time_s_2", "\u00e4 \u4e2d"]
    np.testing.assert_allclose(found[0].head["a_2"], 2 * SIGNAL)
    with open_source(path, ReadOptions(group="group 1")) as source:
        assert source.rate_hz == pytest.approx(4)


def test_every_type_comes_through(tmp_path: Path, tables: Tables) -> None:
    values = {
        kind: (np.arange(ROWS) % 100).astype(kind) for kind in ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4")
    }
    made = [signal(kind, one) for kind, one in values.items()]
    made += [
        signal("big", np.full(ROWS, 2**62 + 1)),
        signal("motorola", np.arange(ROWS).astype(">i4")),
        signal("text", np.array([b"on", b"\xc3\xbc"] * (ROWS // 2)), encoding="utf-8"),
        signal("on", np.arange(ROWS) % 2 == 0),
    ]
    (table,) = tables(written(tmp_path, made))
    for kind, one in values.items():
        np.testing.assert_array_equal(table.head[kind].to_numpy(), one)
        assert table.head[kind].to_numpy().dtype == one.dtype
    assert table.head["big"][0].as_py() == 2**62 + 1
    assert table.head["motorola"].to_pylist() == list(range(ROWS))
    assert table.head["text"].to_pylist()[:2] == ["on", "\u00fc"]
    assert table.head["on"].to_pylist()[:2] == [True, False]


def test_samples_of_several_numbers_become_columns(tmp_path: Path, tables: Tables) -> None:
    axes = np.arange(3.0 * ROWS).reshape(ROWS, 3)
    record = np.rec.fromarrays([SIGNAL, np.arange(ROWS)], dtype=[("x", "f8"), ("y", "i8")])
    vector = np.rec.fromarrays([axes], dtype=[("acc", "f8", (3,))])
    (table,) = tables(written(tmp_path, [signal("acc", vector), signal("pair", record)]))
    assert table.names == ["time_s", "acc_0", "acc_1", "acc_2", "pair.x", "pair.y"]
    np.testing.assert_array_equal(table.head["acc_2"].to_numpy(), axes[:, 2])
    np.testing.assert_array_equal(table.head["pair.x"].to_numpy(), SIGNAL)


def test_conversions_are_applied_once(tmp_path: Path, tables: Tables) -> None:
    counts = np.arange(ROWS, dtype=np.uint8)
    made = [
        signal("rational", counts, conversion={"P1": 0, "P2": 2.0, "P3": 1, "P4": 0, "P5": 0, "P6": 4.0}),
        signal("formula", counts, conversion={"formula": "sqrt(X1) * 2"}),
        signal(
            "table", counts, conversion={"raw_0": 0, "phys_0": 0, "raw_1": 100, "phys_1": 10, "interpolation": True}
        ),
        signal("gear", counts % 2, conversion={"val_0": 0, "text_0": b"low", "val_1": 1, "text_1": b"high"}),
        signal("evil", counts, conversion={"formula": "__import__('os').system('true')"}),
    ]
    (table,) = tables(written(tmp_path, made))
    np.testing.assert_allclose(table.head["rational"], (2 * counts + 1) / 4)
    np.testing.assert_allclose(table.head["formula"], np.sqrt(counts.astype(float)) * 2)
    np.testing.assert_allclose(table.head["table"], counts / 10)
    assert table.head["gear"].to_pylist()[:3] == ["low", "high", "low"]
    assert "evil" not in table.names
    assert "'evil' was left out: its formula" in table.notes[0]


def test_names_for_a_few_numbers_are_missing_numbers(tmp_path: Path, tables: Tables) -> None:
    counts = np.where(np.arange(ROWS) % 9 == 4, 255, np.arange(ROWS)).astype(np.uint8)
    scale = {"a": 0.5, "b": 0.0}
    told = {"val_0": 255, "text_0": b"invalid", "default_addr": scale}
    (table,) = tables(written(tmp_path, [signal("a", counts, conversion=told)]))
    expected = np.where(counts == 255, np.nan, counts * 0.5)
    np.testing.assert_array_equal(table.head["a"].to_numpy(), expected)


def test_invalid_samples_are_missing(tmp_path: Path, tables: Tables) -> None:
    bad = np.arange(ROWS) % 7 == 3
    made = [
        signal("a", SIGNAL, invalidation_bits=bad),
        signal("n", np.arange(ROWS), invalidation_bits=~bad),
        signal("b", SIGNAL),
    ]
    path = written(tmp_path, made)
    (table,) = tables(path)
    assert table.head["n"].null_count == ROWS - bad.sum()
    assert table.head["b"].null_count == 0
    np.testing.assert_array_equal(becalm.read(path, channels="a").samples[:, 0], np.where(bad, np.nan, SIGNAL))


def test_stamps_in_large_integers_keep_their_digits(tmp_path: Path) -> None:
    nanoseconds = 1_709_295_000_123_456_789 + np.arange(ROWS, dtype=np.int64) * 1_000_003
    path = tmp_path / "log.mf4"
    with MDF() as log:
        log.append([signal("a", SIGNAL)])
        log.save(path, overwrite=True)
    data = path.read_bytes()
    with MDF(path) as log:
        master = log.groups[0].channels[0]
        assert master.channel_type == 2
        address, width = log.groups[0].data_blocks[0].address, log.groups[0].channel_group.samples_byte_nr
    changed = bytearray(data)
    changed[master.address + 24 + 8 * 8 + 2] = 2  # signed integers
    for row, stamp in enumerate(nanoseconds.tolist()):
        changed[address + row * width : address + row * width + 8] = stamp.to_bytes(8, "little")
    path.write_bytes(changed)
    read = becalm.read(path)
    np.testing.assert_array_equal(read.times_s, (nanoseconds - nanoseconds[0]).astype(float))


@pytest.mark.parametrize("compression", [0, 1, 2])
def test_a_chunk_is_a_slice_of_the_whole(compression: Literal[0, 1, 2], tmp_path: Path) -> None:
    times, values = np.arange(20_000) / 100, np.arange(20_000) * 0.5
    plain, path = (
        written(tmp_path, [signal("a", values, t=times), signal("b", -values, t=times)]),
        tmp_path / "packed.mf4",
    )
    with MDF(plain) as log:
        log.configure(write_fragment_size=16_000)
        log.save(path, overwrite=True, compression=compression)
    with open_source(path) as source:
        whole = source.recording().samples
        np.testing.assert_array_equal(whole, np.stack([values, -values], axis=1))
        for chunk in source.chunks(3333):
            np.testing.assert_array_equal(chunk.samples, whole[chunk.first_row : chunk.first_row + len(chunk)])


def test_channels_in_blocks_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "log.mf4"
    own: dict[str, Any] = {"column_storage": True}
    with MDF(version="4.20", **own) as log:
        log.append([signal("a", SIGNAL), signal("b", 2 * SIGNAL)])
        log.save(path, overwrite=True)
    np.testing.assert_array_equal(becalm.read(path).samples, np.stack([SIGNAL, 2 * SIGNAL], axis=1))
