"""Count the rows of each sensor in a file of a lake; read only the columns that identify sensors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from becalm.errors import BecalmError, InputError
from becalm.files.decoding import Original
from becalm.files.parquet import read_parquet
from becalm.fleet.marks import hash_input
from becalm.fleet.names import name_sensors, values_in


class Count(NamedTuple):
    """The number of rows of each sensor in a file.

    Attributes
    ----------
    rows : dict of str to int
        Rows by the name of the sensor.
    hashed : str
        A hash of the file, which changes if the file changes.
    failed : str
        A sentence on why the file cannot be read; empty if it was read.
    """

    rows: dict[str, int]
    hashed: str = ""
    failed: str = ""


def count_rows(lake: str, keys: Sequence[str], file: str) -> Count:
    """Count the rows of each sensor in a file; an error is returned as `failed`, not raised.

    Parameters
    ----------
    lake : str
        The folder of the lake.
    keys : sequence of str
        Columns, or keys of folders, that identify sensors.
    file : str
        The file's path within the lake.
    """
    try:
        path = Path(lake) / file
        hashed = hash_input([(file, path)], "", {})  # before the read, so that a change during it is detected
        return Count(_rows(path, file, keys), hashed)
    except BecalmError as cause:
        return Count({}, failed=str(cause))
    except Exception as cause:  # file damage that no check detects
        return Count({}, failed=f"{file} cannot be read: {type(cause).__name__}: {cause}")


def report_lost_file(file: str, why: str) -> Count:
    """Return the count of a file on which every worker died: no rows, and the reason."""
    return Count({}, failed=f"{file} cannot be read. {why}")


def _rows(path: Path, file: str, keys: Sequence[str]) -> dict[str, int]:
    table, from_folders = read_parquet(path, Original(path)), values_in(Path(file).parent)
    rows, columns = Counter[str](), [key for key in keys if key not in from_folders]
    if lacks := [key for key in columns if key not in table.names]:
        raise InputError(
            f"{path} has no column {lacks[0]!r} to identify its sensor, unlike other files of this lake; it has"
            f" {', '.join(table.names)}. Move it elsewhere, or clean it with: becalm clean"
        )
    for block in table.blocks(columns or table.names[:1]):
        names, codes = name_sensors(block, keys, from_folders)
        rows.update(dict(zip(names, np.bincount(codes, minlength=len(names)).tolist(), strict=True)))
    return dict(rows)
