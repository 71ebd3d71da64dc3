"""Select the reader of a file by its content, and the writer of an output by the ending of its name."""

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
from becalm.files.decoding import PARQUET, explain_read_errors, read_bytes
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
"""Output formats by the ending of the file name."""

_SEVERAL_TIMES = frozenset({HDF5, MAT, MF4, NPZ, TDMS})

_WRITTEN_BY = {HDF5: "h5py", MF4: "asammdf", TDMS: "nptdms"}  # becalm writes the other formats itself

BAG = "metadata.yaml"
"""The file that marks a folder as a ROS 2 bag; of any other folder the Parquet files are read."""

_ENDINGS = ".csv, .csv.gz, .h5, .mat, .mf4, .npz, .parquet or .tdms"

_HEAD = 512  # bytes from which formats are recognised


class LibraryFormat(NamedTuple):
    """A format that is recognised by its first bytes and read by a module of its own.

    Attributes
    ----------
    module : str
        The module within `becalm.files`; its `read` takes the path and returns a table for each time base.
    is_it : callable
        Takes the first bytes of a file; returns whether they are of this format.
    """

    module: str
    is_it: Callable[[bytes], bool]


LIBRARY_FORMATS: tuple[LibraryFormat, ...] = (
    LibraryFormat("arrays.hdf5", is_hdf5),
    LibraryFormat("recorders.ide", lambda head: head.startswith(b"\x1a\x45\xdf\xa3") and b"mide" in head[:64]),
    LibraryFormat("arrays.mat", is_mat),
    LibraryFormat("arrays.mat73", is_mat73),
    LibraryFormat("robots.mcap", lambda head: head.startswith(b"\x89MCAP0\r\n")),
    LibraryFormat("recorders.mf4", lambda head: head.startswith((b"MDF     ", b"UnFinMF "))),
    LibraryFormat("arrays.npz", is_npz),
    LibraryFormat("robots.rosbag", lambda head: head.startswith((b"#ROSBAG V", b"SQLite format 3\0"))),
    LibraryFormat("recorders.tdms", lambda head: head.startswith(b"TDSm")),
    LibraryFormat(
        "recorders.uff", lambda head: re.match(rb"\s{0,64}-1 *\r?\n(?=[ \d]{6}) *\d+[bB]?\s", head) is not None
    ),
    LibraryFormat("robots.ulog", lambda head: head.startswith(b"ULog\x01\x125")),
    LibraryFormat(
        "recorders.wav", lambda head: head[:4] in (b"RIFF", b"RIFX", b"RF64", b"BW64") and head[8:12] == b"WAVE"
    ),
)
"""The formats, in the order in which they are tried."""


def read_tables(path: Path) -> tuple[RawTable, ...]:
    """Open a file of any known format, and return a table for each of its time bases.

    The content decides the format, not the name. A folder is a ROS 2 bag, or its Parquet files make one table.

    Raises
    ------
    InputError
        If the file cannot be read, or changes while it is read.
    """
    if (path / BAG).is_file():
        return _foreign_tables("robots.rosbag", path)
    with explain_read_errors(path):
        is_folder, is_pipe = path.is_dir(), not path.is_file()  # or the path does not exist: then reading it raises
    if is_folder:
        return (read_folder(path),)
    if is_pipe:
        data = read_bytes(path)
        if _foreigner(data):
            raise InputError(f"{path} is a pipe, from which only CSV and Parquet can be read; save it as a file first.")
        return (read_parquet(path, data) if data.startswith(PARQUET) else read_csv(path, data),)
    original = Original(path)
    try:
        return tuple(replace(table, original=original) for table in _read_file(path, original))
    finally:
        original.refuse_changed()


def _read_file(path: Path, original: Original) -> tuple[RawTable, ...]:
    head = read_bytes(path, _HEAD)
    if head.startswith(PARQUET):
        return (read_parquet(path, original),)
    if foreigner := _foreigner(head):
        return _foreign_tables(foreigner.module, path)
    return (spool_csv(path) if is_large(path, head) else read_csv(path, read_bytes(path)),)


def _foreign_tables(module: str, path: Path) -> tuple[RawTable, ...]:
    read: Callable[[Path], tuple[RawTable, ...]] = import_module(f"becalm.files.{module}").read
    return read(path)


def _foreigner(head: bytes) -> LibraryFormat | None:
    return next((one for one in LIBRARY_FORMATS if one.is_it(head)), None)


def writable_endings() -> list[str]:
    """Return the endings of the formats that can be written with the libraries that are installed."""
    return [ending for ending, form in ENDINGS.items() if form not in _WRITTEN_BY or find_spec(_WRITTEN_BY[form])]


def holds_times(form: str) -> bool:
    """Return whether a format can store several time bases in one file."""
    return form in _SEVERAL_TIMES


def format_to_write(path: Path) -> str:
    """Return the format of an output by the ending of its name.

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
        raise OutputError(f"{path} has the ending of MDF version 3, but version 4 is written: end the name in .mf4.")
    raise OutputError(f"{path} has an unknown ending {path.suffix!r}; end the name in {_ENDINGS}.")
