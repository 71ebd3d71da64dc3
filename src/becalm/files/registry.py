"""Select the reader of a file by its content, and the writer of an output by the ending of its name."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from becalm.errors import InputError, OutputError
from becalm.files.csv.blocks import is_large
from becalm.files.csv.reader import read_csv
from becalm.files.csv.spool import spool_csv
from becalm.files.decoding import PARQUET, Original, explain_read_errors, read_bytes
from becalm.files.parquet import read_parquet
from becalm.files.signatures import LIBRARY_FORMATS, LibraryFormat
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

_SEVERAL_TIMES = frozenset({HDF5, MAT, MF4, NPZ, TDMS})  # formats whose files can hold several time bases

_WRITTEN_BY = {HDF5: "h5py", MF4: "asammdf", TDMS: "nptdms"}  # optional libraries; the other formats need none

BAG = "metadata.yaml"
"""The file that marks a folder as a ROS 2 bag; any other folder is read as a folder of Parquet files."""

_ENDINGS = ".csv, .csv.gz, .h5, .mat, .mf4, .npz, .parquet or .tdms"

_HEAD = 512  # number of bytes at the start of a file by which its format is recognised


def read_tables(path: Path) -> tuple[RawTable, ...]:
    """Open a file of any known format, and return a table for each of its time bases.

    The content decides the format, not the name. A folder is a ROS 2 bag, or its Parquet files make one table.

    Raises
    ------
    InputError
        If the file cannot be read, or changes while it is read.
    """
    if (path / BAG).is_file():
        return _library_tables("robots.rosbag", path)
    with explain_read_errors(path):
        is_folder, is_pipe = path.is_dir(), not path.is_file()  # a missing path counts as a pipe, and reading it raises
    if is_folder:
        from becalm.files.lake.folder import read_folder  # imported only to read a folder

        return (read_folder(path),)
    if is_pipe:
        data = read_bytes(path)
        if _library_format(data):
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
    if form := _library_format(head):
        return _library_tables(form.module, path)
    return (spool_csv(path) if is_large(path, head) else read_csv(path, read_bytes(path)),)


def _library_tables(module: str, path: Path) -> tuple[RawTable, ...]:
    from becalm.files.libraries.library_process import read_in_subprocess  # imported only to read such a file

    return read_in_subprocess(f"becalm.files.{module}", path)


def _library_format(head: bytes) -> LibraryFormat | None:
    return next((one for one in LIBRARY_FORMATS if one.matches(head)), None)


def writable_endings() -> list[str]:
    """Return the endings of the formats that can be written with the libraries that are installed."""
    return [ending for ending, form in ENDINGS.items() if form not in _WRITTEN_BY or find_spec(_WRITTEN_BY[form])]


def stores_several_times(form: str) -> bool:
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
