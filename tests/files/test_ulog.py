"""ULog: each topic and instance by its own stamps."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from pyulog import ULog

from becalm.errors import InputError
from becalm.files import ReadOptions, read_source
from becalm.files.units.unit_spelling import parse_header
from robot_logs import by_name, drone, part, topic, ulog, whole
from test_real_files import real


def test_each_topic_and_instance_is_a_group(tmp_path: Path) -> None:
    tables = by_name(drone(tmp_path / "a.bin"))
    assert list(tables) == ["gyro_0", "gyro_1", "state_0"]
    assert tables["gyro_1"].names == ["time_s", "gyro_1/rad[0]", "gyro_1/rad[1]", "gyro_1/bias"]
    first = whole(tables["gyro_0"])
    np.testing.assert_array_equal(first["gyro_0/rad[0]"], np.arange(60.0))
    np.testing.assert_array_equal(whole(tables["gyro_1"])["gyro_1/bias"], np.ones(60))
    np.testing.assert_array_equal(first["time_s"], (500 + 4000 * np.arange(60)) / 1e6)


def test_what_begins_late_keeps_its_time_and_texts_and_flags_pass(tmp_path: Path) -> None:
    state = whole(by_name(drone(tmp_path / "a.ulg"))["state_0"])
    assert state["time_s"].to_pylist() == [0.2, 0.25, 0.3, 0.35]
    assert state["armed"].to_pylist() == [False, False, True, True]
    assert state["mode"].to_pylist() == ["go"] * 4


def test_dropouts_are_told(tmp_path: Path) -> None:
    assert by_name(drone(tmp_path / "a.ulg"))["gyro_0"].notes == (
        "The logger lost messages 2 times, for 0.042 s in all.",
    )


def test_stamps_of_any_size_keep_their_digits_and_are_sorted(tmp_path: Path) -> None:
    start = 2**60
    stamps = [start + 3, start + 1, start + 2]
    data = [part("D", struct.pack("<HQf", 0, at, at - start)) for at in stamps]
    kind = part("F", b"a:uint64_t timestamp;float x;")
    path = ulog(tmp_path / "a.ulg", kind, topic(0, "a"), *data, start_us=start)
    (table,) = by_name(path).values()
    assert whole(table).to_pydict() == {"time_s": [1e-6, 2e-6, 3e-6], "x": [1.0, 2.0, 3.0]}
    assert table.notes == ("Messages came out of order (1 times) and were sorted by their time.",)


def test_nested_and_repeated_names_stay_apart(tmp_path: Path) -> None:
    kinds = part("F", b"point:float x;float y;"), part("F", b"a:uint64_t timestamp;point[2] p;float time_s;")
    row = part("D", struct.pack("<HQfffff", 0, 1_000_000, 1, 2, 3, 4, 5))
    (table,) = by_name(ulog(tmp_path / "a.ulg", *kinds, topic(0, "a"), row)).values()
    assert whole(table).to_pylist() == [
        {"time_s": 0.0, "p[0].x": 1.0, "p[0].y": 2.0, "p[1].x": 3.0, "p[1].y": 4.0, "time_s_2": 5.0}
    ]


def test_a_topic_without_stamps_hides_no_other(tmp_path: Path) -> None:
    kinds = part("F", b"a:float t;"), part("F", b"b:uint64_t timestamp;float x;")
    rows = [part("D", struct.pack("<Hf", 0, 1)), part("D", struct.pack("<HQf", 1, 1_000_000, 2))]
    (table,) = by_name(ulog(tmp_path / "a.ulg", *kinds, topic(0, "a"), topic(1, "b"), *rows * 3)).values()
    assert table.count == 3
    assert table.notes == ("Left out, because their messages have no timestamp: a.",)


@pytest.mark.parametrize("kept", range(10, 100, 10))
def test_what_is_whole_of_a_log_is_read(tmp_path: Path, kept: int) -> None:
    data = drone(tmp_path / "a.ulg").read_bytes()
    path = tmp_path / "cut.ulg"
    path.write_bytes(data[: len(data) * kept // 100])
    for table in by_name(path).values():
        first = whole(table).column(1).to_pylist() if table.group != "state_0" else []
        assert first == list(range(len(first)))


def test_a_log_that_ends_within_a_message_says_so(tmp_path: Path) -> None:
    path = drone(tmp_path / "a.ulg")
    path.write_bytes(path.read_bytes()[:-3])
    assert "The file ends in the middle of a message; those before it were read." in by_name(path)["state_0"].notes


@pytest.mark.parametrize(
    "kinds",
    [
        (b"a:uint64_t timestamp;a x;",),
        (b"a:uint64_t timestamp;b[65535] x;", b"b:c[65535] x;", b"c:float[65535] x;"),
    ],
)
def test_formats_without_an_end_are_refused(tmp_path: Path, kinds: tuple[bytes, ...]) -> None:
    with pytest.raises(InputError, match="is a damaged ULog file"):
        by_name(ulog(tmp_path / "a.ulg", *[part("F", kind) for kind in kinds], topic(0, "a")))


def test_a_log_without_messages_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no channel with rows"):
        by_name(ulog(tmp_path / "a.ulg", part("F", b"a:uint64_t timestamp;float x;")))


def test_the_library_prints_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = drone(tmp_path / "a.ulg").read_bytes()
    path = tmp_path / "b.ulg"
    path.write_bytes(data[:700] + b"\0" * 50 + data[700:])
    assert any("damaged" in note for note in by_name(path)["gyro_0"].notes)
    assert capsys.readouterr() == ("", "")


def test_a_place_in_a_list_is_no_unit() -> None:
    assert parse_header("gyro_rad[0]") == ("gyro_rad[0]", "")
    assert parse_header("force [N]") == ("force", "N")


def test_a_real_log_is_read_as_by_its_library() -> None:
    path = real("px4/sample_log_small.ulg")
    tables = by_name(path)
    topics = {f"{topic.name}_{topic.multi_id}": topic for topic in ULog(str(path)).data_list}
    assert list(tables) == list(topics)
    for name, table in tables.items():
        values = whole(table)
        for field, held in topics[name].data.items():
            own = f"{name}/{field}" if f"{name}/{field}" in table.names else field
            if own in table.names:
                np.testing.assert_array_equal(np.asarray(values[own]), held)
    combined = read_source(path, ReadOptions(group="sensor_combined_0")).recording
    assert combined.rate_hz == pytest.approx(204.58, abs=0.01)
    assert set(combined.units) == {""}


def test_topics_of_far_too_many_fields_are_refused(tmp_path: Path) -> None:
    kind = part("F", b"a:uint64_t timestamp;float[65000] b;")
    path = ulog(tmp_path / "a.ulg", kind, *(topic(number, "a") for number in range(10)))
    with pytest.raises(InputError, match="more than 500,000 fields"):
        by_name(path)
