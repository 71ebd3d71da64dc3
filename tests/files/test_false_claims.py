"""Files that claim far more than they hold, in every format: refused, or read as far as they go, in bounded memory."""

from __future__ import annotations

import bz2
import gzip
import json
import os
import resource
import sqlite3
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.writer import CompressionType
from nptdms import ChannelObject, TdmsWriter

from mdf_logs import SIGNAL, signal, written
from robot_logs import EPOCH_NS, bag2, drone, json_log, part, topic, ulog
from test_mf4_damage import raw_blocks

MANY = 10_000_000_000
MEMORY_BYTES = 2 << 30
LIMIT_S = 120  # for all of them
FEW_THREADS = {"OPENBLAS_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}  # each reserves addresses, which count as memory

pytestmark = pytest.mark.slow
VALUES = np.arange(1.0, 61.0)

_READ = """
import json, sys
from becalm.errors import BecalmError
from becalm.files.registry import read_tables
from pathlib import Path
for path in map(Path, sys.argv[1:]):
    rows, zeros, says = 0, 0, ""
    try:
        for table in read_tables(path):
            says += " ".join(table.notes)
            for block in table.blocks(table.names):
                rows += block.num_rows
                if "a" in table.names:
                    zeros += block["a"].to_pylist().count(0.0)
            table.rows.close()
    except BecalmError as told:
        says += str(told)
    print(json.dumps([path.name, rows, zeros, says]), flush=True)
"""


def _nothing_of_it(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("a", (MANY,), "f8")


def _late(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("a", (MANY,), "f8", chunks=(1000,))[-1000:] = 1.0


def _text(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["a"] = VALUES
        file["names"] = ["one", "two"]
    data = bytearray(path.read_bytes())
    heap = data.index(b"GCOL")
    at = data.index(struct.pack("<IQI", 3, heap, 1))
    data[at : at + 4] = b"\xff" * 4
    path.write_bytes(data)


def _mat(path: Path, size: tuple[int, int], kind: int, values: bytes, packed: bool = False) -> None:
    def element(number: int, data: bytes) -> bytes:
        return struct.pack("<II", number, len(data)) + data + bytes(-len(data) % 8)

    inside = element(6, struct.pack("<II", kind, 0)) + element(5, struct.pack("<2i", *size))
    whole = element(14, inside + element(1, b"a") + element(9 if kind == 6 else 1, values))
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(head + (element(15, zlib.compress(whole)) if packed else whole))


def _mat4(path: Path) -> None:
    path.write_bytes(struct.pack("<5I", 0, 2**31 - 1, 4, 0, 2) + b"a\0" + VALUES.tobytes())


def _npy(path: Path) -> None:
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (MANY,)})
        file.write(VALUES.tobytes())


def _npz_member(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive, archive.open("a.npy", "w") as file:
        np.lib.format.write_array(file, VALUES)
    data = bytearray(path.read_bytes())
    entry = data.index(b"PK\x01\x02")
    data[entry + 20 : entry + 24] = data[entry + 24 : entry + 28] = struct.pack("<I", 2**32 - 2)
    path.write_bytes(data)


def _npz_all(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(3):
            with archive.open(f"a{number}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, np.zeros(12_000_000))


def _tdms(path: Path, name_bytes: int | None) -> None:
    with TdmsWriter(str(path)) as writer:
        writer.write_segment([ChannelObject("run", "a", VALUES, {"wf_increment": 0.01})])
    data = path.read_bytes()
    if name_bytes is None:
        data = data.replace(struct.pack("<IQ", 1, len(VALUES)), struct.pack("<IQ", 1, MANY))
    else:
        data = data.replace(struct.pack("<I", 12) + b"wf_increment", struct.pack("<I", name_bytes) + b"wf_increment")
    path.write_bytes(data)


def _mf4(path: Path, compression: Any) -> None:
    from asammdf import MDF

    with MDF(written(path.parent, [signal("a", 1 + SIGNAL**2)])) as log:
        log.save(path, overwrite=True, compression=compression)
    data = bytearray(path.read_bytes())
    (group,) = raw_blocks(path, b"##CG")
    links = int.from_bytes(data[group + 16 : group + 24], "little")
    data[group + 24 + 8 * links + 8 : group + 24 + 8 * links + 16] = struct.pack("<Q", MANY)
    for block in raw_blocks(path, b"##DZ"):
        data[block + 32 : block + 40] = struct.pack("<Q", 24 * MANY)
    path.write_bytes(data)


def _wav(path: Path) -> None:
    data = VALUES.astype("<f4").tobytes()
    head = b"WAVEfmt " + struct.pack("<IHHIIHH", 16, 3, 1, 8000, 32000, 4, 32)
    path.write_bytes(b"RIFF" + struct.pack("<I", 2**32 - 2) + head + b"data" + struct.pack("<I", 2**32 - 2) + data)


def _uff(path: Path, spaces: int = 0) -> None:
    from test_uff import one_set
    from test_uff import written as uff

    whole = uff(path.parent, one_set(binary=1)).read_bytes()
    first = whole.index(b"58b")
    size = slice(first + 27, first + 39)
    told = b"%12d" % (0 if spaces else MANY)
    closing = whole.rindex(b"    -1")
    path.write_bytes(whole[: size.start] + told + whole[size.stop : closing] + b" " * spaces + whole[closing:])


def _mcap(path: Path) -> None:
    log = json_log(path, [(EPOCH_NS, {"a": 1.5})], compression=CompressionType.ZSTD)
    data = bytearray(log.read_bytes())
    at = data.index(b"\x06", 8)
    while data[at + 1 + 8 + 16 + 8 + 4 : at + 1 + 8 + 16 + 8 + 12] != struct.pack("<I", 4) + b"zstd":
        at = data.index(b"\x06", at + 1)
    data[at + 25 : at + 33] = struct.pack("<Q", MANY)
    path.write_bytes(data)


def _ros1(path: Path, parts: int) -> None:
    def field(name: bytes, value: bytes) -> bytes:
        return struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value

    def record(fields: bytes, data: bytes) -> bytes:
        return struct.pack("<I", len(fields)) + fields + struct.pack("<I", len(data)) + data

    size = 2**32 - 1 if parts == 1 else 130 << 20
    packed = bz2.compress(bytes(1 << 10 if parts == 1 else size))
    about = field(b"op", b"\x05") + field(b"compression", b"bz2") + field(b"size", struct.pack("<I", size))
    path.write_bytes(b"#ROSBAG V2.0\n" + record(about, packed) * parts)


def _ros2(path: Path) -> None:
    file = next(bag2(path.with_suffix(""), "SQLITE3").glob("*.db3"))
    opened = sqlite3.connect(file)
    opened.execute("DROP TABLE messages")
    made = "data BLOB AS (zeroblob(900000000))"
    opened.execute(f"CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, {made})")
    opened.execute("INSERT INTO messages (topic_id, timestamp) VALUES (1, 1)")
    opened.commit()
    opened.close()
    file.rename(path)


def _ulog(path: Path) -> None:
    parts = [part("F", b"a%d:uint64_t timestamp;a%d[250] b;" % (n, n + 1)) for n in range(4)]
    ulog(path, *parts, part("F", b"a4:float x;"), topic(0, "a0"))


def _ulog_topics(path: Path) -> None:
    kind = part("F", b"a:uint64_t timestamp;float[65000] b;")
    ulog(path, kind, *(topic(number, "a") for number in range(100)))


def _drone(path: Path) -> None:
    drone(path)
    data = path.read_bytes()
    path.write_bytes(data[:-40] + struct.pack("<HB", 0xFFFF, ord("D")) + data[-40:])


def _parquet(path: Path) -> None:
    table = pa.table({"a": pa.array(np.ones(40_000_000))})
    pq.write_table(table, path, compression="zstd", row_group_size=len(table))


def _csv(path: Path, last: bytes) -> None:
    row = (b"1," + b"0" * (1 << 15) + b"\n") * 128
    packed = gzip.compress(b"t,a\n") + gzip.compress(row, 9) * 80 + gzip.compress(last)
    path.write_bytes(packed)


def _ide(path: Path) -> None:
    endless = b"\x18\x52\x80\x67\x01\xff\xff\xff\xff\xff\xff\xfe"
    path.write_bytes(b"\x1a\x45\xdf\xa3\x87\x42\x82\x84mide" + endless + bytes(80))


CLAIMS: dict[str, Callable[[Path], None]] = {
    "nothing.h5": _nothing_of_it,
    "late.h5": _late,
    "text.h5": _text,
    "values.mat": lambda path: _mat(path, (2**31 - 1, 1), 6, VALUES.tobytes()),
    "packed.mat": lambda path: _mat(path, (2**31 - 1, 1), 6, VALUES.tobytes(), packed=True),
    "lines.mat": lambda path: _mat(path, (2**31 - 1, 0), 4, b"abc"),
    "four.mat": _mat4,
    "one.npy": _npy,
    "member.npz": _npz_member,
    "all.npz": _npz_all,
    "values.tdms": lambda path: _tdms(path, None),
    "name.tdms": lambda path: _tdms(path, 2**32 - 1),
    "rows.mf4": lambda path: _mf4(path, 0),
    "packed.mf4": lambda path: _mf4(path, 1),
    "a.wav": _wav,
    "size.uff": _uff,
    "spaces.uff": lambda path: _uff(path, 5_000_000),
    "a.mcap": _mcap,
    "one.bag": lambda path: _ros1(path, 1),
    "all.bag": lambda path: _ros1(path, 3),
    "a.db3": _ros2,
    "fields.ulg": _ulog,
    "topics.ulg": _ulog_topics,
    "message.ulg": _drone,
    "a.parquet": _parquet,
    "large.csv.gz": lambda path: _csv(path, b"1,2\n"),
    "a.ide": _ide,
}

READ = {"one.npy", "text.h5", "values.tdms", "rows.mf4", "a.wav", "size.uff", "spaces.uff", "message.ulg"}
"""Those of which the beginning can be read."""

WHOLE = {"size.uff", "spaces.uff", "values.tdms"}
"""Those of which all is there, whatever their size is said to be."""

Told = dict[str, tuple[int, int, str]]


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Told:
    """Read all of them in one process that has little memory; its last word tells where it ended."""
    folder = tmp_path_factory.mktemp("claims")
    for name, make in CLAIMS.items():
        make(folder / name)
    ran = subprocess.run(
        [sys.executable, "-c", _READ, *(str(folder / name) for name in CLAIMS)],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES)),
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **FEW_THREADS},
        check=False,
    )
    assert ran.returncode == 0, ran.stdout[-300:] + ran.stderr[-2000:]
    return {name: (rows, zeros, says) for name, rows, zeros, says in map(json.loads, ran.stdout.splitlines())}


@pytest.mark.parametrize("name", CLAIMS)
def test_what_claims_too_much_is_refused_or_read_as_far_as_it_goes(name: str, told: Told) -> None:
    rows, zeros, says = told[name]
    assert (0 < rows < 1000) == (name in READ)
    assert zeros == 0
    assert bool(says) == (name not in WHOLE)
