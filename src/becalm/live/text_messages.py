"""Messages as text: JSON objects and lines of CSV."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.files.units import parse_header
from becalm.live.messages import Told, UnreadableError, Wanted, first_of


def from_json(payload: bytes, wanted: Wanted) -> Told:
    """Return what a JSON message told: a row, columns as lists, or a list of row objects.

    Raises
    ------
    UnreadableError
        If it holds no such thing. What the parser raises goes through.
    """
    held = json.loads(payload)
    if isinstance(held, list):
        held = _columns(held)
    elif not isinstance(held, dict):
        raise UnreadableError("which is no object")
    units = held.pop("units", {})
    names = wanted.channels(held)
    columns = {name: _numbers(name, held.get(name)) for name in names}
    rows = len(columns[names[0]])
    if not rows or any(len(column) != rows for column in columns.values()):
        raise UnreadableError("whose columns have no rows, or not the same number of them")
    time_s = _numbers(wanted.time, held[wanted.time]) if wanted.time in held else None
    if time_s is not None and len(time_s) != rows:
        raise UnreadableError(f"which has {len(time_s)} stamps of {rows} rows")
    words = units if isinstance(units, dict) else {}
    return Told(
        tuple(names),
        tuple(str(words.get(name, "")) for name in names),
        _seq(held["seq"], rows) if "seq" in held else None,
        time_s,
        np.stack([columns[name] for name in names], axis=1),
    )


def from_csv(payload: bytes, wanted: Wanted) -> Told:
    """Return what lines of CSV told, in the columns that the address named.

    Raises
    ------
    UnreadableError
        If the address named none, or a line does not fit them.
    """
    if not wanted.columns:
        raise UnreadableError("which is neither Arrow nor JSON (of CSV, name the columns: ?columns=time,ax,ay)")
    lines = [line for line in payload.decode("utf-8").splitlines() if line.strip()]
    cells = [[_number(cell) for cell in line.split(",")] for line in lines]
    if not cells or any(len(row) != len(wanted.columns) for row in cells):
        raise UnreadableError(f"which has no rows, or one that has not {len(wanted.columns)} columns")
    table = np.array(cells, dtype=np.float64)
    heads = [parse_header(column) for column in wanted.columns]
    there = {name: column for column, (name, _) in enumerate(heads)}
    channels = [column for column, (name, _) in enumerate(heads) if name not in (wanted.time, "seq")]
    if not channels:
        raise UnreadableError("which has no channels")
    return Told(
        tuple(heads[column][0] for column in channels),
        tuple(heads[column][1] for column in channels),
        first_of(table[:, there["seq"]]) if "seq" in there else None,
        np.ascontiguousarray(table[:, there[wanted.time]]) if wanted.time in there else None,
        np.ascontiguousarray(table[:, channels]),
    )


def _columns(rows: list[Any]) -> dict[str, Any]:
    """Turn a list of row objects into columns."""
    if not rows or not all(isinstance(row, dict) and row.keys() == rows[0].keys() for row in rows):
        raise UnreadableError("which is no list of rows with the same columns")
    columns: dict[str, Any] = {name: [row[name] for row in rows] for name in rows[0]}
    if "units" in columns:
        columns["units"] = columns["units"][0]
    return columns


def _numbers(name: str, held: object) -> Floats:
    """Return a number, or a list of numbers and nulls, as a column."""
    numbers = held if isinstance(held, list) else [held]
    if not all(number is None or type(number) in (int, float) for number in numbers):
        raise UnreadableError(f"which has no numbers in {name[:40]!r}")
    return np.array(numbers, dtype=np.float64)


def _seq(held: object, rows: int) -> int:
    """Return the first row's number, told alone or with every row's."""
    if type(held) is int:
        return held
    numbers = _numbers("seq", held)
    if len(numbers) != rows:
        raise UnreadableError("whose seq does not number its rows one by one")
    return first_of(numbers)


def _number(cell: str) -> float:
    return float(cell) if cell.strip() else float("nan")
