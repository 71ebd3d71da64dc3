"""Which reader and which writer: by content first, by the ending of the name second."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from becalm.errors import InputError, OutputError
from becalm.files.csv_reader import read_csv
from becalm.files.csv_spool import spool_csv
from becalm.files.hdf5 import is_hdf5
from becalm.files.identity import Original
from becalm.files.mat import is_mat
from becalm.files.mat73 import is_mat73
from becalm.files.npz import is_npz
from becalm.files.parquet import read_parquet
from becalm.files.source import RawTable
from becalm.files.text import PARQUET, read_bytes, told
from becalm.files.text_blocks import is_large

CSV, CSV_GZ, HDF5, MAT, NPZ, PARQUET_FORMAT = "csv", "csv.gz", "hdf5", "mat", "npz", "parquet"

ENDINGS: dict[str, str] = {
    ".csv": CSV,
    ".txt": CSV,
    ".csv.gz": CSV_GZ,
    ".txt.gz": CSV_GZ,
    ".h5": HDF5,
    ".hdf5": HDF5,
    ".mat": MAT,
    ".npz": NPZ,
    ".parquet": PARQUET_FORMAT,
    ".pq": PARQUET_FORMAT,
}
"""What the ending of an output's name asks for."""

_ENDINGS = ".csv, .csv.gz, .h5, .mat, .npz or .parquet"

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
    Foreigner("hdf5", is_hdf5),
    Foreigner("mat", is_mat),
    Foreigner("mat73", is_mat73),
    Foreigner("npz", is_npz),
)
"""In the order in which they are tried."""


def read_tables(path: Path) -> tuple[RawTable, ...]:
    """Look into a file of any known format: a table for each time base in it; its content decides, whatever its name.

    Raises
    ------
    InputError
        If it cannot be read, or changes meanwhile.
    """
    with told(path):
        once = not path.is_file()  # a pipe; or nothing
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
        read: Callable[[Path], tuple[RawTable, ...]] = import_module(f"becalm.files.{found.module}").read
        return read(path)
    return (spool_csv(path) if is_large(path, head) else read_csv(path, read_bytes(path)),)


def _foreigner(head: bytes) -> Foreigner | None:
    return next((one for one in FOREIGNERS if one.is_it(head)), None)


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
    raise OutputError(f"{path} has an unknown ending {path.suffix!r}; end the name in {_ENDINGS}.")
