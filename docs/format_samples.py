"""Write the same recording in every format that becalm reads: four noisy channels in m/s^2, 1000 rows a second.

becalm writes the formats that it can write; the libraries of the field write the others. No library writes IDE files,
so `formats.py` uses a real one.
"""

from __future__ import annotations

import json
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import becalm

RATE_HZ = 1000.0
NAMES = ("ax", "ay", "az", "aw")
UNIT = "m/s^2"
_EPOCH_NS = 1_700_000_000_000_000_000
_STEP_NS = round(1e9 / RATE_HZ)


class Sample(NamedTuple):
    """A format, and a function that writes a file of it.

    Attributes
    ----------
    name : str
        Usual name of the format.
    endings : tuple of str
        Usual endings of file names; the sample has the first one. becalm does not need them: the content decides.
    make : callable
        Function that writes a file with a number of rows at a path; returns the path of the file, which may be in a
        folder.
    many : int
        Number of rows of a file that is large enough to measure the memory that it takes.
    """

    name: str
    endings: tuple[str, ...]
    make: Callable[[Path, int], Path]
    many: int = 500_000


def signal(rows: int) -> NDArray[np.float64]:
    """Return (rows, 4) readings in m/s^2."""
    slow = np.sin(np.arange(rows) / 200)[:, None]
    return slow + np.random.default_rng(11).normal(0, 0.1, (rows, len(NAMES)))


def _own(path: Path, rows: int) -> Path:
    """Write a file with becalm, in the format of its ending."""
    names = [f"{name} ({UNIT})" for name in NAMES] if ".csv" in path.name else NAMES
    becalm.write(path, becalm.Recording(signal(rows), names=names, units=[UNIT] * len(NAMES), rate_hz=RATE_HZ))
    return path


def _mat73(path: Path, rows: int) -> Path:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        file["time_s"] = np.arange(rows)[None] / RATE_HZ
        for name, values in zip(NAMES, signal(rows).T, strict=True):
            file[name] = values[None]
        for held in file.values():
            held.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    return path


def _tdms(path: Path, rows: int) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    properties = {"wf_increment": 1 / RATE_HZ, "wf_samples": 1, "unit_string": UNIT}
    with TdmsWriter(str(path)) as writer:
        for values in np.array_split(signal(rows), 20):  # a logger also writes several segments
            writer.write_segment([ChannelObject("run", *one, properties) for one in zip(NAMES, values.T, strict=True)])
    return path


def _uff(path: Path, rows: int) -> Path:
    from pyuff import UFF, prepare_58

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # the library does not close its file
        for name, values in zip(NAMES, signal(rows).T, strict=True):
            one = prepare_58(
                **{"binary": 1, "func_type": 1, "rsp_node": 1, "rsp_dir": 1, "ref_node": 0, "ref_dir": 0},
                **{"data": values, "x": np.arange(rows) / RATE_HZ, "id1": name, "abscissa_spacing": 1},
                **{"abscissa_spec_data_type": 17, "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 0},
                **{"ordinate_axis_units_lab": UNIT, "abscissa_axis_units_lab": "s", "ord_data_type": 4},
            )
            UFF(str(path)).write_sets([one], mode="add")
    return path


def _wav(path: Path, rows: int) -> Path:
    from scipy.io import wavfile

    wavfile.write(path, int(RATE_HZ), signal(rows).astype(np.float32))
    return path


def _ulog(path: Path, rows: int) -> Path:
    def part(kind: str, data: bytes) -> bytes:
        return struct.pack("<HB", len(data), ord(kind)) + data

    fields = "".join(f"float {name};" for name in NAMES)
    stamps_us = 1_000_000 + np.arange(rows) * _STEP_NS // 1000
    with path.open("wb") as file:
        file.write(b"ULog\x01\x125\x01" + struct.pack("<Q", 1_000_000) + part("B", bytes(40)))
        file.write(
            part("F", f"acc:uint64_t timestamp;{fields}".encode()) + part("A", struct.pack("<BH", 0, 0) + b"acc")
        )
        for stamp_us, values in zip(stamps_us.tolist(), signal(rows).tolist(), strict=True):
            file.write(part("D", struct.pack("<HQ4f", 0, stamp_us, *values)))
    return path


def _mcap(path: Path, rows: int) -> Path:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        topic = writer.register_channel("/acc", "json", writer.register_schema("acc", "jsonschema", b"{}"))
        for row, values in enumerate(signal(rows).tolist()):
            at_ns = _EPOCH_NS + row * _STEP_NS
            writer.add_message(topic, at_ns, json.dumps(dict(zip(NAMES, values, strict=True))).encode(), at_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _bag1(path: Path, rows: int) -> Path:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS1_NOETIC), "geometry_msgs/msg/Quaternion"
    with Writer(path) as writer:
        topic = writer.add_connection("/acc", kind, typestore=store)
        for row, values in enumerate(signal(rows).tolist()):
            message = store.serialize_ros1(store.types[kind](*values), kind)
            writer.write(topic, _EPOCH_NS + row * _STEP_NS, message)
    return path


def _bag2(path: Path, rows: int) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS2_HUMBLE), "geometry_msgs/msg/Quaternion"
    folder = path.with_suffix("")
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection("/acc", kind, typestore=store)
        for row, values in enumerate(signal(rows).tolist()):
            message = store.serialize_cdr(store.types[kind](*values), kind)
            writer.write(topic, _EPOCH_NS + row * _STEP_NS, message)
    return next(folder.glob("*.db3"))


SAMPLES: tuple[Sample, ...] = (
    Sample("CSV", (".csv", ".txt"), _own, 1_000_000),
    Sample("CSV, gzipped", (".csv.gz", ".txt.gz"), _own, 1_000_000),
    Sample("Parquet", (".parquet", ".pq"), _own),
    Sample("ASAM MF4 (MDF 3 and 4)", (".mf4", ".mdf", ".dat"), _own),
    Sample("NI TDMS", (".tdms",), _tdms),
    Sample("UFF58, UFF58b", (".uff", ".unv"), _uff),
    Sample("MAT (4 to 7.2)", (".mat",), _own),
    Sample("MAT 7.3", (".mat",), _mat73),
    Sample("HDF5", (".h5", ".hdf5"), _own),
    Sample("NPZ", (".npz",), _own),
    Sample("WAV", (".wav",), _wav),
    Sample("ROS 1 bag", (".bag",), _bag1, 50_000),
    Sample("ROS 2 bag", (".db3", "folder"), _bag2, 50_000),
    Sample("MCAP", (".mcap",), _mcap, 50_000),
    Sample("PX4 ULog", (".ulg",), _ulog, 200_000),
)
