"""Read MAT files of versions 4 and 5 into memory, one variable after another; version 7.3 is HDF5."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from becalm.errors import InputError
from becalm.files.arrays.array_groups import Grouping
from becalm.files.arrays.array_labels import take_labels
from becalm.files.arrays.arrays import FileArrays, Leaf
from becalm.files.arrays.mat_elements import Variable, variables4, variables5
from becalm.files.arrays.mat_values import Opaque, value_of
from becalm.files.groups import tables
from becalm.files.library_reader import Foreign
from becalm.files.signatures import is_mat5
from becalm.files.source import RawTable

MOST_ELEMENTS = 1024
"""Largest number of elements that are read of a cell array or an array of structs."""

SAVE_AS = "; save it from MATLAB as plain arrays: S = table2struct(T, 'ToScalar', true)"
"""Advice for objects that only MATLAB can open."""


def read(path: Path) -> tuple[RawTable, ...]:
    """Read the tables of a MAT file of version 4 or 5; nested variables get dotted names.

    Raises
    ------
    InputError
        If no variable in it can be read.
    """
    foreign = Foreign(path, "MAT")
    contents = FileArrays()
    with foreign.explain_damage():
        data = memoryview(path.read_bytes())
        for variable in variables5(foreign, data) if is_mat5(bytes(data[:128])) else variables4(data):
            _add(contents, variable)
    take_labels(contents)
    groups = Grouping(contents, ".", apart=False).groups()
    if not groups and contents.notes:
        raise InputError(f"{path} holds no channel that can be read: {' '.join(contents.notes)[:500]}")
    return tables(foreign, "mat", groups)


def _add(contents: FileArrays, variable: Variable) -> None:
    """Add one variable, or a note if it cannot be read."""
    if not variable.name and not variable.why:
        return  # internal data of MATLAB
    label = repr(variable.name) if variable.name else "A variable"
    why = variable.why
    if not why:
        try:
            held = _values(variable)
        except Exception as cause:  # scipy raises many types for a damaged variable
            why = " ".join(str(cause).split())[:100] or type(cause).__name__
        else:
            _hold(contents, (variable.name,), held)
    if why:
        contents.notes.append(f"{label} is not read: {why}{SAVE_AS if 'only MATLAB' in why else ''}.")


def _values(variable: Variable) -> Any:
    if variable.order:
        data = memoryview(variable.data)
        return value_of(data, 8, 8 + struct.unpack(variable.order + "4xI", data[:8])[0], variable.order)
    from scipy.io import loadmat

    return loadmat(io.BytesIO(variable.data))[variable.name]  # type: ignore[arg-type]  # takes files


def _hold(contents: FileArrays, path: tuple[str, ...], value: Any) -> None:
    """Add the arrays of a value, also those nested in structs and cells."""
    if isinstance(value, Opaque):
        contents.notes.append(f"{'.'.join(path)!r} is not read: only MATLAB can open it{SAVE_AS}.")
    elif value.dtype.names:
        _hold_struct(contents, path, value)
    elif value.dtype.kind == "O":
        _hold_cells(contents, path, value)
    else:
        contents.add(Leaf.of(path, value))


def _hold_struct(contents: FileArrays, path: tuple[str, ...], value: NDArray[Any]) -> None:
    elements = value.ravel(order="F")
    names = value.dtype.names or ()
    records = len(elements) > 1 and all(_is_single(one) for name in names for one in elements[name])
    for name in names:
        held = elements[name]
        if records:
            contents.add(Leaf.of((*path, name), np.array([one.item() if one.size else "" for one in held])))
            continue
        for number, one in enumerate(held[:MOST_ELEMENTS], start=1):
            where = path if len(elements) == 1 else (*path[:-1], f"{path[-1]}({number})")
            _hold(contents, (*where, name), one)


def _hold_cells(contents: FileArrays, path: tuple[str, ...], value: NDArray[Any]) -> None:
    cells = value.ravel(order="F")
    if all(isinstance(one, np.ndarray) and one.dtype.kind == "U" and one.size <= 1 for one in cells):
        contents.add(Leaf.of(path, np.array([one.item() if one.size else "" for one in cells], object)))
    elif len(cells) > 1 and all(isinstance(one, np.ndarray) and _is_number(one) for one in cells):
        contents.add(Leaf.of(path, np.array([one.item() for one in cells])))
    else:
        for number, one in enumerate(cells[:MOST_ELEMENTS], start=1):
            _hold(contents, (*path[:-1], f"{path[-1]}{{{number}}}"), one)


def _is_number(value: NDArray[Any]) -> bool:
    return value.size == 1 and value.dtype.kind in "biuf" and not value.dtype.names


def _is_single(value: object) -> bool:
    """Return whether a value is a single number or a single text."""
    return isinstance(value, np.ndarray) and (_is_number(value) or (value.dtype.kind == "U" and value.size <= 1))
