"""Read time responses in UFF58 and 58b, universal files of vibration testing; sets with equal times form a table."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Floats
from becalm.errors import InputError
from becalm.files.column_statistics import Column
from becalm.files.groups import TIME, Group, tables
from becalm.files.library_reader import LibraryFile
from becalm.files.recorders.uff_blocks import UffBlock, Values, blocks_of
from becalm.files.source import FormatTime, RawTable
from becalm.files.text.csv_header import unique_names
from becalm.files.units.unit_spelling import tidy_unit

_TIME_RESPONSE, _GENERAL, _ABSCISSA_TIME = 1, 0, 17  # two types of functions; the type of an abscissa that is a time
_SECONDS = {"": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
_AXES = {0: "", 1: "X", 2: "Y", 3: "Z", 4: "RX", 5: "RY", 6: "RZ"}  # directions of a measurement
_DATE = "%d-%b-%y %H:%M:%S"  # in the header of a set


class _Set(NamedTuple):
    """A set of the file: one function of time."""

    header: dict[str, Any]
    values: Values

    @property
    def rows(self) -> int:
        return self.values.rows

    @property
    def even(self) -> bool:
        return bool(self.header["abscissa_spacing"])

    @property
    def unit_s(self) -> float:
        """Return the length of its unit of time in seconds."""
        return _SECONDS[_label(self.header, "abscissa")]

    @property
    def time(self) -> tuple[object, ...]:
        """Return a key that is equal for all sets of one table."""
        shared = (self.rows, self.even, self.unit_s, _start(self.header))
        if self.even:
            return (*shared, self.header["abscissa_min"], self.header["abscissa_inc"])
        return (*shared, hashlib.blake2b(self.values.abscissa(0, self.rows).tobytes()).digest())


def read(path: Path) -> tuple[RawTable, ...]:
    """Read the tables of a universal file.

    Raises
    ------
    InputError
        If it is damaged, or holds no time response.
    """
    library_file = LibraryFile(path, "UFF")
    library = library_file.library("pyuff")
    with library_file.explain_damage():
        blocks, cut = blocks_of(path)
        if not blocks:
            raise InputError(f"{path} is UFF without a complete set 58; becalm needs a function of time.")
        left_out: list[str] = []
        sets: list[_Set] = []
        for header, block in zip(_headers(library.UFF, blocks), blocks, strict=True):
            if why := _not_read(header):
                left_out.append(f"{_name(header)!r} {why}")
            else:
                sets.append(_Set(header, block.values(path, header)))
        if not sets:
            raise InputError(
                f"{path} is UFF without a time response: the set {left_out[0]}. Export the signal"
                " as a function of time (type 1)."
            )
        ends = ("The file ends within the head of a set, which was left out.",) if cut else ()
        return tables(library_file, "uff", list(_groups(sets, (*_left_out_notes(left_out), *ends))))


def _headers(reader: Callable[[str], Any], blocks: Sequence[UffBlock]) -> list[dict[str, Any]]:
    """Read the headers of all sets with the library, without their numbers."""
    with TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        heads = Path(folder) / "heads.uff"
        heads.write_bytes(b"".join(b"    -1\n" + block.head + b"    -1\n" for block in blocks))
        headers = reader(str(heads)).read_sets(header_only=True)
    return headers if isinstance(headers, list) else [headers]


def _not_read(header: dict[str, Any]) -> str:
    """Return why a set is not read, or "" if it is."""
    of_time = header["abscissa_spec_data_type"] == _ABSCISSA_TIME
    if header["func_type"] != _TIME_RESPONSE and not (header["func_type"] == _GENERAL and of_time):
        return f"is a function of type {header['func_type']}, not a time response"
    if header["ord_data_type"] not in (2, 4):
        return "has complex values"
    if (unit := _label(header, "abscissa")) not in _SECONDS:
        return f"is a function of {unit!r}, which is not a unit of time"
    if header["abscissa_spacing"] and not 0.0 < header["abscissa_inc"] < np.inf:
        return f"has a time step of {header['abscissa_inc']}"
    return ""


def _left_out_notes(left_out: Sequence[str]) -> Iterator[str]:
    if left_out:
        more = f", and {len(left_out) - 1} more sets" if len(left_out) > 1 else ""
        yield f"Left out: {left_out[0]}{more}."


def _groups(sets: Sequence[_Set], notes: tuple[str, ...]) -> Iterator[Group]:
    held: dict[tuple[object, ...], list[_Set]] = {}
    for one in sets:
        held.setdefault(one.time, []).append(one)
    plain = [str(one.header["id1"]).strip() for one in sets]
    for members in held.values():
        first = members[0]
        names = [_name(one.header) for one in members]
        full = [
            f"{name} {_place(one.header)}" if plain.count(name) > 1 else name
            for name, one in zip(names, members, strict=True)
        ]
        columns, time = {}, FormatTime(rate_hz=None, start=_start(first.header))
        if first.even:
            time = FormatTime("", 1.0 / (first.header["abscissa_inc"] * first.unit_s), time.start)
        else:
            columns[TIME] = Column(pa.float64(), _seconds(first), "s")
            time = FormatTime(TIME, None, time.start)
        for name, one in zip(unique_names(full), members, strict=True):
            columns[name] = Column(pa.float64(), one.values.ordinate, _label(one.header, "ordinate"))
        short = [one.rows for one in members if not one.values.complete]
        cut = (f"A set of the file is cut off; {short[0]} rows are whole and were read.",) if short else ()
        yield Group(names[0], columns, first.rows, time, (*notes, *cut))


def _seconds(one: _Set) -> Callable[[int, int], Floats]:
    start = float(one.values.abscissa(0, 1)[0])

    def read_seconds(first: int, last: int) -> Floats:
        return (one.values.abscissa(first, last) - start) * one.unit_s

    return read_seconds


def _name(header: dict[str, Any]) -> str:
    name = str(header["id1"]).strip()
    return name if _is_given(name) else f"node {_place(header)}"


def _place(header: dict[str, Any]) -> str:
    """Return the node and direction of a measurement, such as `3+Z`."""
    node, direction = header["rsp_node"], header["rsp_dir"]
    return f"{node}{'-' if direction < 0 else '+'}{_AXES.get(abs(direction), '')}" if direction else f"{node}"


def _is_given(text: str) -> bool:
    return text.upper() not in ("", "NONE")


def _label(header: dict[str, Any], axis: str) -> str:
    unit = str(header.get(f"{axis}_axis_units_lab", "")).strip()
    return tidy_unit(unit) if _is_given(unit) else ""


def _start(header: dict[str, Any]) -> str:
    """Return the start of the recording from the third line of the header, or "" if it is not a date."""
    with suppress(ValueError):
        return datetime.strptime(str(header["id3"]).strip(), _DATE).isoformat()
    return ""
