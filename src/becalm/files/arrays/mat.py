"""Read MAT files of versions 4 and 5 with SciPy, one variable after another; version 7.3 is HDF5."""

from __future__ import annotations

import io
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.exceptions import ComplexWarning
from numpy.typing import NDArray

from becalm.errors import InputError
from becalm.files.arrays.array_groups import Grouping
from becalm.files.arrays.array_labels import apply_labels
from becalm.files.arrays.arrays import FileArrays, Leaf
from becalm.files.groups import tables
from becalm.files.library_reader import LibraryFile
from becalm.files.signatures import is_mat5
from becalm.files.source import RawTable

MOST_ELEMENTS = 1024
"""Largest number of elements of a cell array, or of an array of structs, that are read as separate arrays."""

SAVE_AS = "; save it from MATLAB as plain arrays: S = table2struct(T, 'ToScalar', true)"
"""Advice for objects that only MATLAB can open."""

SPARSE = "it is a sparse matrix; save it from MATLAB as full(A)"
"""Message: why a sparse matrix is not read, and what the user can do."""

_HEAD5, _TAG, _COMPRESSED = 128, 8, 15  # version 5: bytes of the header and of a tag; type of a compressed element
_NUMBERS4 = (8, 4, 4, 2, 2, 1)  # bytes of a value, by the tens digit of a type code in version 4
_CUT = "the file ends in it"


class _Variable(NamedTuple):
    """A variable as the bytes of a MAT file with only it, and the reason why it is not read; "" if it is read."""

    file: bytes
    why: str = ""


def read(path: Path) -> tuple[RawTable, ...]:
    """Read the tables of a MAT file of version 4 or 5; nested variables get dotted names.

    Raises
    ------
    InputError
        If no variable in it can be read.
    """
    library_file = LibraryFile(path, "MAT")
    contents = FileArrays()
    with library_file.explain_damage():
        data = path.read_bytes()
        for variable in _variables5(data) if is_mat5(data[:_HEAD5]) else _variables4(data):
            _add(contents, variable)
    apply_labels(contents)
    groups = Grouping(contents, ".", apart=False).groups()
    if not groups and contents.notes:
        raise InputError(f"{path} holds no channel that can be read: {' '.join(contents.notes)[:500]}")
    return tables(library_file, "mat", groups)


def _variables5(data: bytes) -> Iterator[_Variable]:
    """Yield the variables of version 5: each is an element, which begins with its type and length."""
    order, at = "<" if data[126:128] == b"IM" else ">", _HEAD5
    while at < len(data):
        if at + _TAG > len(data):
            yield _Variable(b"", _CUT)
            return
        kind, length = struct.unpack(order + "II", data[at : at + _TAG])
        end = at + _TAG + length
        yield _Variable(data[:_HEAD5] + data[at:end], _CUT if end > len(data) else "")
        at = end if kind == _COMPRESSED else end + -length % 8


def _variables4(data: bytes) -> Iterator[_Variable]:
    """Yield the variables of version 4, each a file of its own."""
    at, order = 0, "<" if struct.unpack("<I", data[:4])[0] < 5000 else ">"
    while at < len(data):
        if at + 20 > len(data):
            yield _Variable(b"", _CUT)
            return
        kind, rows, columns, imaginary, letters = struct.unpack(order + "IIIII", data[at : at + 20])
        stored = kind // 10 % 10
        if kind >= 5000 or stored >= len(_NUMBERS4) or kind % 10 > 2 or letters > 256 or imaginary > 1:
            yield _Variable(b"", "it begins with a type that does not exist")
            return
        end = at + 20 + letters + rows * columns * (1 + imaginary) * _NUMBERS4[stored]
        yield _Variable(data[at:end], _CUT if end > len(data) else "")
        at = end


def _add(contents: FileArrays, variable: _Variable) -> None:
    """Add one variable, or a note if it cannot be read."""
    why = variable.why
    if not why:
        try:
            named = _loaded(variable)
        except MemoryError:
            raise
        except Exception as cause:  # SciPy raises many types for a damaged variable
            why = " ".join(str(cause).split())[:100] or type(cause).__name__
        else:
            for name, value in named.items():
                if not name.startswith("__"):  # metadata of SciPy and MATLAB
                    _add_value(contents, (name,), value)
    if why:
        name = _name(variable)
        contents.notes.append(f"{repr(name) if name else 'A variable'} is not read: {why}.")


def _loaded(variable: _Variable) -> dict[str, Any]:
    """Return the values by name, in MATLAB's types; complex values in the type in which they are stored."""
    from scipy.io import loadmat

    with warnings.catch_warnings():
        warnings.simplefilter("error", ComplexWarning)
        try:
            return dict(loadmat(io.BytesIO(variable.file), mat_dtype=True))  # type: ignore[arg-type]  # takes files
        except ComplexWarning:
            return dict(loadmat(io.BytesIO(variable.file)))  # type: ignore[arg-type]


def _name(variable: _Variable) -> str:
    """Return the name of a variable that cannot be read; "" if damage makes it unreadable."""
    from scipy.io import whosmat

    try:
        return str(whosmat(io.BytesIO(variable.file))[0][0])  # type: ignore[arg-type]  # takes files
    except Exception:  # SciPy raises many types for a damaged variable
        return ""


def _add_value(contents: FileArrays, path: tuple[str, ...], value: Any) -> None:
    """Add the arrays of a value, also those nested in structs and cells."""
    if why := _why_not(value):
        contents.notes.append(f"{'.'.join(path)!r} is not read: {why}.")
    elif value.dtype.names:
        _add_struct(contents, path, value)
    elif value.dtype.kind == "O":
        _add_cells(contents, path, value)
    elif value.dtype.kind == "U":
        contents.add(Leaf.of(path, np.char.rstrip(value, " \0")))  # the lines of a char matrix are padded
    else:
        contents.add(Leaf.of(path, value))


def _why_not(value: Any) -> str:
    """Return the reason why a value is not read, "" if it is."""
    from scipy.io.matlab import MatlabFunction, MatlabOpaque
    from scipy.sparse import issparse

    if isinstance(value, MatlabOpaque):
        kinds = [one.decode("latin-1") if isinstance(one, bytes) else str(one) for one in value.ravel()[:1]["s2"]]
        return f"it is a MATLAB {kinds[0] if kinds else 'object'}, which only MATLAB opens{SAVE_AS}"
    if isinstance(value, MatlabFunction):
        return f"it is a MATLAB function, which only MATLAB opens{SAVE_AS}"
    return SPARSE if issparse(value) else "" if isinstance(value, np.ndarray) else f"it is {type(value).__name__}"


def _add_struct(contents: FileArrays, path: tuple[str, ...], value: NDArray[Any]) -> None:
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
            _add_value(contents, (*where, name), one)


def _add_cells(contents: FileArrays, path: tuple[str, ...], value: NDArray[Any]) -> None:
    cells = value.ravel(order="F")
    if all(isinstance(one, np.ndarray) and one.dtype.kind == "U" and one.size <= 1 for one in cells):
        contents.add(Leaf.of(path, np.array([one.item() if one.size else "" for one in cells], object)))
    elif len(cells) > 1 and all(isinstance(one, np.ndarray) and _is_number(one) for one in cells):
        contents.add(Leaf.of(path, np.array([one.item() for one in cells])))
    else:
        for number, one in enumerate(cells[:MOST_ELEMENTS], start=1):
            _add_value(contents, (*path[:-1], f"{path[-1]}{{{number}}}"), one)


def _is_number(value: NDArray[Any]) -> bool:
    return value.size == 1 and value.dtype.kind in "biuf" and not value.dtype.names


def _is_single(value: object) -> bool:
    """Return whether a value is a single number or a single text."""
    return isinstance(value, np.ndarray) and (_is_number(value) or (value.dtype.kind == "U" and value.size <= 1))
