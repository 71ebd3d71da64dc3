"""Load the compiled C99 kernel, and read the layout of its structs and its constants from it."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from becalm.errors import BecalmError

LIBRARY = Path(__file__).with_name("kernel.dll" if sys.platform == "win32" else "kernel.so")


class _Field(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_char_p),
        ("offset", ctypes.c_int64),
        ("size", ctypes.c_int64),
        ("whole", ctypes.c_int64),
    )


def _loaded() -> ctypes.CDLL:
    try:
        return ctypes.CDLL(str(LIBRARY))
    except OSError as cause:
        raise BecalmError(
            f"becalm's C filter is missing, or not for this machine ({cause}). Install becalm again: pip install ."
        ) from cause


kernel = _loaded()


def layout_of(struct: str) -> np.dtype[np.void]:
    """Return the NumPy dtype of a C struct, with the fields that Python reads or writes, listed in `layout.c`."""
    *fields, end = _fields_of(f"channel_{struct}_fields")
    counts = [field.size // 8 for field in fields]
    layout: Any = {
        "names": [field.name.decode() for field in fields],
        "formats": [
            f"{count if count > 1 else ''}{'i8' if field.whole else 'f8'}"
            for field, count in zip(fields, counts, strict=True)
        ],
        "offsets": [field.offset for field in fields],
        "itemsize": end.offset,
    }
    structure: np.dtype[np.void] = np.dtype(layout)
    return structure


def _fields_of(function: str) -> list[Any]:
    """Return the fields that a C function lists; the last entry has no name, and its offset is the struct's size."""
    list_fields = getattr(kernel, function)
    list_fields.restype = ctypes.POINTER(_Field)
    fields = list[Any]()
    for field in list_fields():
        fields.append(field)
        if field.name is None:
            break
    return fields


CONSTANTS: dict[str, int] = {value.name.decode(): value.size for value in _fields_of("channel_constants")[:-1]}
"""Whole numbers that C and Python both use, by their names in C."""


# Check the arrays of a block of rows and return C's structs; C would read or write beyond the ends of wrong arrays.

SETTINGS, COEFFICIENTS = map(layout_of, ("settings", "coefficients"))
MOST_STATES = CONSTANTS["N_MAX"]
_ROWS = ("z", "elapsed", "step", "F", "Q")
_ESTIMATES = ("signal", "sigma", "verdict", "innovation", "deviation", "x")


class RowBlock(ctypes.Structure):
    """A block of rows; see `block_t`."""

    _fields_ = (*((name, ctypes.c_void_p) for name in _ROWS), ("rows", ctypes.c_int64))


class RowEstimates(ctypes.Structure):
    """The estimates of a block of rows; see `estimate_t`."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in _ESTIMATES)


def checked(settings: NDArray[np.void], rows: dict[str, Any], *, writes: bool = True) -> tuple[RowBlock, RowEstimates]:
    """Return C's structs for a block of rows and for its estimates.

    Parameters
    ----------
    settings : () structured array
        The settings of the channel.
    rows : dict of str to array
        The arrays of `process`.
    writes : bool
        Whether C writes estimates.

    Raises
    ------
    ValueError
        If the arrays do not fit each other.
    """
    n, count = int(settings["states"]), len(rows["z"])
    if settings.dtype != SETTINGS or not 1 <= n <= MOST_STATES:
        raise ValueError(f"A channel of {n} states came; 1 to {MOST_STATES} are needed.")
    shapes = {"step": ("i4", (count,)), "verdict": ("i1", (count,)), "x": ("f8", (count, n))}
    shapes |= dict.fromkeys(("F", "Q"), ("f8", (len(rows["F"]), n, n)))
    names = *_ROWS, *(name for name in _ESTIMATES if writes and (name != "x" or name in rows))
    wanted = {name: shapes.get(name, ("f8", (count,))) for name in names}
    for name, (kind, shape) in wanted.items():
        array = rows[name]
        flags = array.flags
        in_place = flags.c_contiguous and flags.aligned and (flags.writeable or name in _ROWS)
        if array.dtype != kind or array.shape != shape or not in_place:
            raise ValueError(f"{name} is {array.dtype} of shape {array.shape}, not {kind} of {shape} in one piece.")
    if count and not (rows["step"].min() >= 0 and rows["step"].max() < len(rows["F"])):
        lowest, highest = rows["step"].min(), rows["step"].max()
        raise ValueError(f"step goes from {lowest} to {highest}; there are {len(rows['F'])} steps.")
    if not (rows["elapsed"] >= 0).all():
        raise ValueError("elapsed is NaN or below 0 somewhere; give steps of 0 or more.")
    at = {name: rows[name].ctypes.data for name in wanted}
    block = RowBlock(at["z"], at["elapsed"], at["step"], at["F"], at["Q"], count)
    estimate = RowEstimates(*(at.get(name) for name in _ESTIMATES))
    return block, estimate
