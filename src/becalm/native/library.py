"""Load the compiled C99 kernel, and read the layout of its structs and its constants from it."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path
from typing import Any

import numpy as np

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
    """Return the NumPy dtype of a struct of `kernel.h`, with the fields that Python reads or writes."""
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
    """Return the fields that a C function lists; the last one has no name, and its offset is the struct's size."""
    list_fields = getattr(kernel, function)
    list_fields.restype = ctypes.POINTER(_Field)
    fields = list[Any]()
    for field in list_fields():
        fields.append(field)
        if field.name is None:
            break
    return fields


CONSTANTS: dict[str, int] = {value.name.decode(): value.size for value in _fields_of("channel_constants")[:-1]}
"""Whole numbers that C and Python share, by their names in `kernel.h`."""
