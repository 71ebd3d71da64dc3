"""Which reader and which writer: by content first, by the ending of the name second."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from becalm.errors import InputError, OutputError
from becalm.files.arrays.hdf5 import is_hdf5
from becalm.files.arrays.mat import is_mat
from becalm.files.arrays.mat73 import is_mat73
from becalm.files.arrays.npz import is_npz
from becalm.files.csv.blocks import is_large
from becalm.files.csv.reader import read_csv
from becalm.files.csv.spool import spool_csv
from becalm.files.decoding import PARQUET, read_bytes, told
from becalm.files.identity import Original
from becalm.files.lake.folder import read_folder
from becalm.files.parquet import read_parquet
from becalm.files.source import RawTable

CSV, CSV_GZ, HDF5, MAT, MF4, NPZ, TDMS = "csv", "csv.gz", "hdf5", "mat", "mf4", "npz", "tdms"
PARQUET_FORMAT = "parquet"

ENDINGS: dict[str, str] = {
    ".csv": CSV,
    ".txt": CSV,
    ".csv.gz": CSV_GZ,
    ".txt.gz": CSV_GZ,
    ".h5": HDF5,
    ".hdf5": HDF5,
    ".mat": MAT,
    ".mf4": MF4,
    ".npz": NPZ,
    ".parquet": PARQUET_FORMAT,
    ".pq": PARQUET_FORMAT,
    ".tdms": TDMS,
}
"""What the ending of an output's name asks for."""

_SEVERAL_TIMES = frozenset({HDF5, MAT, MF4, NPZ, TDMS})

_WRITTEN_BY = {HDF5: "h5py", MF4: "asammdf", TDMS: "nptdms"}  # all else becalm writes by itself

BAG = "metadata.yaml"
"""What a folder holds that ROS 2 recorded into; of any other folder the Parquet files are read."""

_ENDINGS = ".csv, .csv.gz, .h5, .mat, .mf4, .npz, .parquet or .tdms"

_HEAD = 512  # bytes that tell a format


class Foreigner(NamedTuple):
    """A format that another library reads.

    Attributes
    ----------
    module : str
        In this room; its `read` takes the path and gives a table for each time base.
    is_it : callable
        Whether the first bytes of a file are of this format.
    """

    module: str
    is_it: Callable[[bytes], bool]


FOREIGNERS: tuple[Foreigner, ...] = (
    Foreigner("arrays.hdf5", is_hdf5),
    Foreigner("recorders.ide", lambda head: head.startswith(b"\x1a\x45\xdf\xa3") and b"mide" in head[:64]),
    Foreigner("arrays.mat", is_mat),
    Foreigner("arrays.mat73", is_mat73),
    Foreigner("robots.mcap", lambda head: head.startswith(b"\x89MCAP0\r\n")),
    Foreigner("recorders.mf4", lambda head: head.startswith((b"MDF     ", b"UnFinMF "))),
    Foreigner("arrays.npz", is_npz),
    Foreigner("robots.rosbag", lambda head: head.startswith((b"#ROSBAG V", b"SQLite format 3\0"))),
    Foreigner("recorders.tdms", lambda head: head.startswith(b"TDSm")),
    Foreigner("recorders.uff", lambda head: re.match(rb"\s{0,64}-1 *\r?\n(?=[ \d]{6}) *\d+[bB]?\s", head) is not None),
    Foreigner("robots.ulog", lambda head: head.startswith(b"ULog\x01\x125")),
    Foreigner("recorders.wav", lambda head: head[:4] in (b"RIFF", b"RIFX", b"RF64", b"BW64") and head[8:12] == b"WAVE"),
)
"""In the order in which they are tried."""


def read_tables(path: Path) -> tuple[RawTable, ...]:
    """Look into a file of any known format: a table for each time base in it; its content decides, whatever its name.

    Of a folder that is no ROS 2 bag, all Parquet files are one table.

    Raises
    ------
    InputError
        If it cannot be read, or changes meanwhile.
    """
    if (path / BAG).is_file():
        return _foreign_tables("robots.rosbag", path)
    with told(path):
        folder, once = path.is_dir(), not path.is_file()  # a pipe; or nothing
    if folder:
        return (read_folder(path),)
    if once:
        data = read_bytes(path)
        if _foreigner(data):
            raise InputError(f"{path} is a pipe, of which only CSV and Parquet are read; save it as a file first.")
        return (read_parquet(path, data) if data.startswith(PARQUET) else read_csv(path, data),)
    original = Original(path)
    try:
        return tuple(replace(table, original=original) for table in _read_again_and_again(path, original))
    finally:
        original.refuse_changed()


def _read_again_and_again(path: Path, original: Original) -> tuple[RawTable, ...]:
    head = read_bytes(path, _HEAD)
    if head.startswith(PARQUET):
        return (read_parquet(path, original),)
    if found := _foreigner(head):
        return _foreign_tables(found.module, path)
    return (spool_csv(path) if is_large(path, head) else read_csv(path, read_bytes(path)),)


def _foreign_tables(module: str, path: Path) -> tuple[RawTable, ...]:
    read: Callable[[Path], tuple[RawTable, ...]] = import_module(f"becalm.files.{module}").read
    return read(path)


def _foreigner(head: bytes) -> Foreigner | None:
    return next((one for one in FOREIGNERS if one.is_it(head)), None)


def endings_here() -> list[str]:
    """Return the endings of formats that can be written by what is installed here."""
    return [ending for ending, form in ENDINGS.items() if form not in _WRITTEN_BY or find_spec(_WRITTEN_BY[form])]


def holds_times(form: str) -> bool:
    """Whether a format holds channels at several times."""
    return form in _SEVERAL_TIMES


def format_to_write(path: Path) -> str:
    """Return the format that an output's name asks for.

    Raises
    ------
    OutputError
        If no format has that ending.
    """
    name = path.name.lower()
    for ending in sorted(ENDINGS, key=len, reverse=True):
        if name.endswith(ending):
            return ENDINGS[ending]
    if name.endswith(".mdf"):
        raise OutputError(
            f"{path} is the name of an MDF file of version 3; version 4 is written: end the name in .mf4."
        )
    raise OutputError(f"{path} has an unknown ending {path.suffix!r}; end the name in {_ENDINGS}.")
