"""Read messages as text: JSON and lines of CSV."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.live.lines.cells import number_of
from becalm.live.messages.columns import SEQ, ParsedMessage, RoleFinder, UnreadableMessageError, first_of, stamps_of


def from_json(payload: bytes, finder: RoleFinder) -> ParsedMessage:
    """Return the rows of a JSON message: one row, columns as lists, or a list of row objects.

    Raises
    ------
    UnreadableMessageError
        If the message has another form. The errors of the JSON parser are raised too.
    """
    message = json.loads(payload)
    if isinstance(message, list):
        message = _columns(message)
    elif not isinstance(message, dict):
        raise UnreadableMessageError("which is not an object")
    units = message.pop("units", {})
    units = units if isinstance(units, dict) else {}
    roles = finder.roles(tuple(message))
    selected = finder.options.channels
    channels = [channel for channel in roles.channels if selected or not _is_text(message[channel[0]])]
    if not channels:
        raise UnreadableMessageError("which has no channels")
    columns = [_json_column(column, message[column]) for column, _, _ in channels]
    rows = len(columns[0])
    if not rows or any(len(column) != rows for column in columns):
        raise UnreadableMessageError("which has no rows, or not the same number of them in all columns")
    time_s = None if roles.stamp is None else stamps_of(roles.stamp, _cells(message[roles.stamp]))
    if time_s is not None and len(time_s) != rows:
        raise UnreadableMessageError(f"which has {len(time_s)} stamps for {rows} rows")
    return ParsedMessage(
        tuple(name for _, name, _ in channels),
        tuple(str(units.get(column) or unit) for column, _, unit in channels),
        None if roles.seq is None else _seq(message[SEQ], rows),
        time_s,
        np.stack(columns, axis=1),
    )


def from_csv(payload: bytes, finder: RoleFinder) -> ParsedMessage:
    """Return the rows of a CSV message, whose columns are given by the address.

    Raises
    ------
    UnreadableMessageError
        If the address has no column names, or a line does not fit them.
    """
    names = finder.options.columns
    if not names:
        raise UnreadableMessageError("which is neither Arrow nor JSON (for CSV, name the columns: ?columns=time,ax,ay)")
    rows = [line.split(",") for line in payload.decode("utf-8").splitlines() if line.strip()]
    if not rows or any(len(row) != len(names) for row in rows):
        raise UnreadableMessageError(f"which has no rows, or a row without {len(names)} columns")
    cells = dict(zip(names, zip(*rows, strict=True), strict=True))
    roles = finder.roles(names)
    if not roles.channels:
        raise UnreadableMessageError("which has no channels")
    return ParsedMessage(
        tuple(name for _, name, _ in roles.channels),
        tuple(unit for _, _, unit in roles.channels),
        None if roles.seq is None else first_of(_csv_column(SEQ, cells[SEQ])),
        None if roles.stamp is None else stamps_of(roles.stamp, cells[roles.stamp]),
        np.stack([_csv_column(column, cells[column]) for column, _, _ in roles.channels], axis=1),
    )


def _columns(rows: list[Any]) -> dict[str, Any]:
    """Convert a list of row objects into columns."""
    if not rows or not all(isinstance(row, dict) and row.keys() == rows[0].keys() for row in rows):
        raise UnreadableMessageError("which is not a list of rows with the same columns")
    columns: dict[str, Any] = {name: [row[name] for row in rows] for name in rows[0]}
    if "units" in columns:
        columns["units"] = columns["units"][0]
    return columns


def _cells(value: object) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _is_text(value: object) -> bool:
    """Return whether a column has text instead of readings, such as the name of a device."""
    return isinstance((_cells(value) or [None])[0], str | dict)


def _json_column(name: str, value: object) -> Floats:
    """Return a number, or a list of numbers and nulls, as a column."""
    numbers = _cells(value)
    if not all(number is None or type(number) in (int, float) for number in numbers):
        raise UnreadableMessageError(f"which has no numbers in {name[:40]!r}")
    return np.array(numbers, dtype=np.float64)


def _csv_column(name: str, cells: tuple[str, ...]) -> Floats:
    """Return cells of CSV as a column."""
    numbers = [number_of(cell) for cell in cells]
    if None in numbers:
        raise UnreadableMessageError(f"which has no numbers in {name[:40]!r}")
    return np.array(numbers, dtype=np.float64)


def _seq(value: object, rows: int) -> int:
    """Return the number of the first row, from that number alone or from a list with the numbers of all rows."""
    if type(value) is int:
        return value
    numbers = _json_column(SEQ, value)
    if len(numbers) != rows:
        raise UnreadableMessageError("whose seq does not number its rows one by one")
    return first_of(numbers)
