"""Logs as robots and drones write them, made for tests; and damaged ones."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Bag1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_typestore

from becalm.files.registry import read_tables
from becalm.files.source import RawTable

EPOCH_NS = 1_700_000_000_000_000_000
STEP_NS = 5_000_000
ROWS = 60

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
IMU, JOINTS, TEXT, PICTURE = (
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
    "std_msgs/msg/String",
    "sensor_msgs/msg/Image",
)


def imu(store: Any, row: int, stamp_ns: int | None = None) -> Any:
    """Return a message whose acceleration is row + 0.5, 2, 9.81, and whose angular velocity 0.1 row, 0, 0."""
    vector, quaternion = store.types["geometry_msgs/msg/Vector3"], store.types["geometry_msgs/msg/Quaternion"]
    return store.types[IMU](
        header=header(store, EPOCH_NS + row * STEP_NS if stamp_ns is None else stamp_ns),
        orientation=quaternion(0.0, 0.0, 0.0, 1.0),
        orientation_covariance=np.arange(9.0),
        angular_velocity=vector(0.1 * row, 0.0, 0.0),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(row + 0.5, 2.0, 9.81),
        linear_acceleration_covariance=np.zeros(9),
    )


def header(store: Any, stamp_ns: int) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    counted = {"seq": 7} if store is ROS1 else {}
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="base", **counted)


def joints(store: Any, row: int, positions: Sequence[float]) -> Any:
    return store.types[JOINTS](
        header=header(store, EPOCH_NS + row * STEP_NS),
        name=["hip", "knee"],
        position=np.array(positions),
        velocity=np.array([]),
        effort=np.array([]),
    )


def bag1(path: Path, compression: str = "", stamps_ns: Sequence[int] | None = None) -> Path:
    """Write a bag of ROS 1: /imu at 200 Hz, logged 1 ms late, and a /chat of texts."""
    writer = Bag1(path)
    if compression:
        writer.set_compression(Bag1.CompressionFormat[compression.upper()])
    with writer:
        of_imu, of_chat = (writer.add_connection(*one, typestore=ROS1) for one in (("/imu", IMU), ("/chat", TEXT)))
        for row in range(ROWS):
            message = imu(ROS1, row, None if stamps_ns is None else stamps_ns[row])
            writer.write(of_imu, EPOCH_NS + row * STEP_NS + 10**6, ROS1.serialize_ros1(message, IMU))
        writer.write(of_chat, EPOCH_NS, ROS1.serialize_ros1(ROS1.types[TEXT]("hello"), TEXT))
    return path


def bag2(path: Path, storage: str, compression: str = "") -> Path:
    """Write a folder of ROS 2: /imu at 200 Hz, /joints at 100 Hz, and one /picture."""
    writer = Bag2(path, version=9, storage_plugin=StoragePlugin[storage])
    if compression:
        writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:
        of_imu, of_joints, of_picture = (
            writer.add_connection(*one, typestore=ROS2)
            for one in (("/imu", IMU), ("/joints", JOINTS), ("/eye", PICTURE))
        )
        for row in range(ROWS):
            at = EPOCH_NS + row * STEP_NS
            writer.write(of_imu, at + 10**6, ROS2.serialize_cdr(imu(ROS2, row), IMU))
            if row % 2 == 0:
                writer.write(of_joints, at, ROS2.serialize_cdr(joints(ROS2, row, (0.5, 0.25 * row)), JOINTS))
        picture = ROS2.types[PICTURE](header(ROS2, EPOCH_NS), 1, 2, "mono8", 0, 2, np.zeros(2, np.uint8))
        writer.write(of_picture, EPOCH_NS, ROS2.serialize_cdr(picture, PICTURE))
    return path


def json_log(path: Path, messages: Sequence[tuple[int, object]], encoding: str = "json", **how: Any) -> Path:
    """Write an MCAP of one topic, /s, from (log time in ns, message)."""
    with path.open("wb") as file:
        writer = Writer(file, **({"compression": CompressionType.NONE} | how))
        writer.start()
        kind = writer.register_schema("thing", "jsonschema", b"{}")
        topic = writer.register_channel("/s", encoding, kind)
        for log_ns, message in messages:
            writer.add_message(topic, log_ns, json.dumps(message).encode(), log_ns - 10**9)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def part(kind: str, data: bytes) -> bytes:
    """Return a message of a ULog."""
    return struct.pack("<HB", len(data), ord(kind)) + data


def ulog(path: Path, *parts: bytes, start_us: int = 1_000_000) -> Path:
    """Write a ULog."""
    path.write_bytes(b"ULog\x01\x125\x01" + struct.pack("<Q", start_us) + b"".join(parts))
    return path


def topic(number: int, name: str, instance: int = 0) -> bytes:
    """Subscribe to a topic of a ULog."""
    return part("A", struct.pack("<BH", instance, number) + name.encode())


def drone(path: Path, rows: int = ROWS) -> Path:
    """Write a log of a drone: two gyroscopes at 250 Hz, and a state with a flag and a text that begins late."""
    gyro = [
        part("D", struct.pack("<HQfff", number, 1_000_500 + 4000 * row, row, 0.5, number))
        for row in range(rows)
        for number in (0, 1)
    ]
    late = [part("D", struct.pack("<HQ?5sB", 2, 1_200_000 + 50_000 * row, row > 1, b"go", row)) for row in range(4)]
    return ulog(
        path,
        part("B", bytes(40)),
        part("F", b"gyro:uint64_t timestamp;float[2] rad;float bias;uint8_t[4] _padding0;"),
        part("F", b"state:uint64_t timestamp;bool armed;char[5] mode;uint8_t step;"),
        topic(0, "gyro"),
        topic(1, "gyro", 1),
        topic(2, "state"),
        *gyro,
        part("O", struct.pack("<H", 30)),
        part("O", struct.pack("<H", 12)),
        *late,
    )


def by_name(path: Path) -> dict[str, RawTable]:
    """Read a file; tables by the names of their groups."""
    return {table.group: table for table in read_tables(path)}


def whole(table: RawTable) -> pa.Table:
    """Read all of a table."""
    return pa.concat_tables(list(table.blocks(table.names)))


def read_through(path: Path) -> list[pa.Table]:
    """Read everything in a file, and close it."""
    tables = read_tables(path)
    try:
        return [whole(table) for table in tables]
    finally:
        for table in tables:
            table.rows.close()


def mutant(data: bytes, seed: int) -> bytes:
    """Damage some bytes: changed, flipped, set to the greatest number, lost, or put between."""
    dice = random.Random(seed)
    out = bytearray(data)
    ways: list[Callable[[int], None]] = [
        lambda at: out.__setitem__(at, dice.randrange(256)),
        lambda at: out.__setitem__(at, out[at] ^ (1 << dice.randrange(8))),
        lambda at: out.__setitem__(slice(at, at + 4), b"\xff" * 4),
        lambda at: out.__delitem__(slice(at, at + dice.randrange(1, 40))),
        lambda at: out.__setitem__(slice(at, at), dice.randbytes(dice.randrange(1, 40))),
    ]
    for _ in range(dice.choice((1, 1, 2, 5, 20))):
        dice.choice(ways)(dice.randrange(len(out)))
    return bytes(out)
