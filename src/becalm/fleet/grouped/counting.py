"""Which sensors each file of a lake holds: only the columns are read that tell them apart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from becalm.errors import BecalmError, InputError
from becalm.files.identity import Original
from becalm.files.parquet import read_parquet
from becalm.fleet.marks import came_of
from becalm.fleet.names import named, values_in


class Count(NamedTuple):
    """What a file holds.

    Attributes
    ----------
    rows : dict of str to int
        How many of each sensor.
    hashed : str
        What tells whether the file is still the same.
    failed : str
        Why neither can be told, as a sentence.
    """

    rows: dict[str, int]
    hashed: str = ""
    failed: str = ""


def count_rows(lake: str, keys: Sequence[str], file: str) -> Count:
    """Count the rows of each sensor in a file; what is wrong with it is told, not raised.

    Parameters
    ----------
    lake : str
        The folder.
    keys : sequence of str
        What tells sensors apart.
    file : str
        Its path within the lake.
    """
    try:
        path = Path(lake) / file
        hashed = came_of([(file, path)], "", {})  # before it is read: what changes meanwhile is seen by the next job
        return Count(_rows(path, file, keys), hashed)
    except BecalmError as cause:
        return Count({}, failed=str(cause))
    except Exception as cause:  # rubbish of a kind that nobody has thought of
        return Count({}, failed=f"{file} cannot be read: {type(cause).__name__}: {cause}")


def not_counted(file: str, why: str) -> Count:
    """Tell of a file that the workers died of."""
    return Count({}, failed=f"{file} cannot be read. {why}")


def _rows(path: Path, file: str, keys: Sequence[str]) -> dict[str, int]:
    table, told = read_parquet(path, Original(path)), values_in(Path(file).parent)
    rows, columns = Counter[str](), [key for key in keys if key not in told]
    if lacks := [key for key in columns if key not in table.names]:
        raise InputError(
            f"{path} has no column {lacks[0]!r} that tells its sensor, as others of this lake have; it has"
            f" {', '.join(table.names)}. Move it elsewhere, or clean it with: becalm clean"
        )
    for block in table.blocks(columns or table.names[:1]):
        names, codes = named(block, keys, told)
        rows.update(dict(zip(names, np.bincount(codes, minlength=len(names)).tolist(), strict=True)))
    return dict(rows)
