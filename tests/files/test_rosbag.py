"""Bags of ROS 1 and ROS 2: each topic by the stamps in its headers."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from becalm.errors import InputError
from becalm.files import ReadOptions, read_source
from robot_logs import EPOCH_NS, ROWS, bag1, bag2, by_name, read_through, whole

LEFT_OUT = "Left out, because they hold images, point clouds, texts or lists of messages"


@pytest.mark.parametrize("compression", ["", "bz2", "lz4"])
def test_numbers_of_ros_1_are_read_exactly(tmp_path: Path, compression: str) -> None:
    (table,) = by_name(bag1(tmp_path / "a.bag", compression)).values()
    rows = whole(table)
    np.testing.assert_array_equal(rows["linear_acceleration.x"], np.arange(ROWS) + 0.5)
    np.testing.assert_array_equal(rows["orientation_covariance_8"], np.full(ROWS, 8.0))
    np.testing.assert_array_equal(rows["time_s"], np.arange(ROWS) / 200)
    assert table.time is not None
    assert table.time.start == "2023-11-14T22:13:20.000000000Z"
    assert table.notes == (
        f"{LEFT_OUT}: /chat (std_msgs/String).",
        "The time is header.stamp.",
        "Texts, nested and long lists were left out: header.frame_id.",
    )


def test_units_of_an_imu_are_known_and_others_are_not_guessed(tmp_path: Path) -> None:
    recording = read_source(bag1(tmp_path / "a.bag")).recording
    units = dict(zip(recording.names, recording.units, strict=True))
    assert (units["linear_acceleration.x"], units["angular_velocity.x"]) == ("m/s^2", "rad/s")
    assert units["orientation.w"] == ""
    assert recording.rate_hz == pytest.approx(200.0)


@pytest.mark.parametrize(
    ("storage", "compression"),
    [
        *(("SQLITE3", how) for how in ("", "FILE", "MESSAGE")),
        *(("MCAP", how) for how in ("", "FILE", "MESSAGE", "STORAGE")),
    ],
)
def test_folders_of_ros_2_are_read_exactly(tmp_path: Path, storage: str, compression: str) -> None:
    tables = by_name(bag2(tmp_path / "run", storage, compression))
    assert list(tables) == ["/imu", "/joints"]
    np.testing.assert_array_equal(whole(tables["/imu"])["linear_acceleration.x"], np.arange(ROWS) + 0.5)
    joints = whole(tables["/joints"])
    np.testing.assert_array_equal(joints["position_1"], 0.5 * np.arange(ROWS // 2))
    np.testing.assert_array_equal(joints["time_s"], np.arange(ROWS // 2) / 100)
    assert f"{LEFT_OUT}: /eye (sensor_msgs/msg/Image)." in tables["/imu"].notes


@pytest.mark.parametrize(("storage", "ending"), [("SQLITE3", "db3"), ("MCAP", "mcap")])
def test_one_file_of_a_folder_is_enough(tmp_path: Path, storage: str, ending: str) -> None:
    (path,) = bag2(tmp_path / "run", storage).glob(f"*.{ending}")
    renamed = path.rename(tmp_path / "no ending?")
    source = read_source(renamed, ReadOptions(group="/joints"))
    assert source.recording.samples.shape == (ROWS // 2, 2)


def test_a_chunk_is_the_slice_of_the_whole(tmp_path: Path) -> None:
    (table,) = by_name(bag1(tmp_path / "a.bag")).values()
    assert next(table.blocks(table.names, 10, 7)).equals(whole(table).slice(10, 7))


def test_late_messages_are_sorted_with_their_values(tmp_path: Path) -> None:
    stamps = [EPOCH_NS + row * 5_000_000 for row in range(ROWS)]
    stamps[10], stamps[11] = stamps[11], stamps[10]
    (table,) = by_name(bag1(tmp_path / "a.bag", stamps_ns=stamps)).values()
    rows = whole(table)
    np.testing.assert_array_equal(rows["time_s"], np.arange(ROWS) / 200)
    assert rows["linear_acceleration.x"].to_pylist()[9:13] == [9.5, 11.5, 10.5, 12.5]
    assert "Messages came out of order (1 times) and were sorted by their time." in table.notes


@pytest.mark.parametrize(
    ("stamps_ns", "why"),
    [
        ([0] * ROWS, "is not set"),
        ([EPOCH_NS] * ROWS, "repeats (59 of 60 messages)"),
        ([EPOCH_NS + (row % 30) * 10**9 + row for row in range(ROWS)], "goes back by 29 s"),
    ],
)
def test_stamps_that_do_not_run_are_not_the_time(tmp_path: Path, stamps_ns: list[int], why: str) -> None:
    (table,) = by_name(bag1(tmp_path / "a.bag", stamps_ns=stamps_ns)).values()
    np.testing.assert_array_equal(whole(table)["time_s"], np.arange(ROWS) / 200)
    (note,) = [note for note in table.notes if note.startswith("The time is")]
    assert note.startswith("The time is when messages were logged, because header.stamp")
    assert why in note


def test_a_bag_that_was_not_closed_is_read(tmp_path: Path) -> None:
    path = bag1(tmp_path / "a.bag")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    (table,) = by_name(path).values()
    rows = whole(table)
    assert 10 < table.count < ROWS
    np.testing.assert_array_equal(rows["linear_acceleration.x"], np.arange(table.count) + 0.5)
    assert "The bag was not closed, or was cut off; the messages that are whole were read." in table.notes


def test_a_database_that_is_cut_off_is_read_up_to_there(tmp_path: Path) -> None:
    (path,) = bag2(tmp_path / "run", "SQLITE3").glob("*.db3")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 8 // 10])
    table = by_name(path)["/imu"]
    assert 0 < table.count < ROWS
    assert "The file is damaged or ends too early; the messages before that were read." in table.notes


def test_types_that_the_bag_does_not_define_are_the_standard_ones(tmp_path: Path) -> None:
    (path,) = bag2(tmp_path / "run", "SQLITE3").glob("*.db3")
    opened = sqlite3.connect(path)
    opened.execute("DROP TABLE message_definitions")
    opened.commit()
    opened.close()
    table = by_name(path)["/imu"]
    assert whole(table)["linear_acceleration.x"].to_pylist()[1] == 1.5
    assert "The bag does not define its types; the standard types of ROS 2 were used." in table.notes


def test_another_database_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.sqlite"
    opened = sqlite3.connect(path)
    opened.execute("CREATE TABLE t (x)")
    opened.commit()
    opened.close()
    with pytest.raises(InputError, match="is an SQLite database, but not a ROS 2 bag"):
        read_through(path)


def test_an_old_bag_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V1.2\n" + bytes(50))
    with pytest.raises(InputError, match=r"of version V1\.2; becalm reads 2\.0\. Type: rosbag fix"):
        read_through(tmp_path / "a.bag")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}", "does not list the files of a ROS 2 bag"),
        (": [", "does not list the files of a ROS 2 bag"),
        (
            "rosbag2_bagfile_information: {relative_file_paths: [a.db3]}",
            r"lacks a\.db3, which its metadata\.yaml names",
        ),
        ("rosbag2_bagfile_information: {relative_file_paths: []}", "is a ROS 2 bag without files"),
    ],
)
def test_a_folder_that_is_no_whole_bag_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_through(tmp_path)


def test_any_other_folder_is_still_a_directory(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a directory"):
        read_through(tmp_path)


@pytest.mark.parametrize("name", ["../../etc/passwd", "/etc/passwd", "a/../../b.db3"])
def test_a_folder_that_names_files_outside_is_refused(name: str, tmp_path: Path) -> None:
    folder = bag2(tmp_path / "bag", "SQLITE3")
    told = (folder / "metadata.yaml").read_text()
    own = next(folder.glob("*.db3")).name
    (folder / "metadata.yaml").write_text(told.replace(f"- {own}", f"- {name}"))
    with pytest.raises(InputError, match="outside of the folder"):
        read_through(folder)
