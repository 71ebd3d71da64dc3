"""Convert units of datasheets by a fixed table: readings, their integrals, and noise per root of hertz or time."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from becalm.errors import UsageError


class _Unit(NamedTuple):
    """The quantity of one unit, and its size in SI."""

    quantity: str
    size: float


_G = 9.80665  # m/s^2
_DEG = math.pi / 180  # rad
_READINGS = {
    "m/s^2": _Unit("acceleration", 1.0),
    "g": _Unit("acceleration", _G),
    "mg": _Unit("acceleration", 1e-3 * _G),
    "ug": _Unit("acceleration", 1e-6 * _G),
    "rad/s": _Unit("angular rate", 1.0),
    "deg/s": _Unit("angular rate", _DEG),
    "mdeg/s": _Unit("angular rate", 1e-3 * _DEG),
    "deg/h": _Unit("angular rate", _DEG / 3600),
    "m/m": _Unit("strain", 1.0),
    "um/m": _Unit("strain", 1e-6),
    "nm/m": _Unit("strain", 1e-9),
}
_INTEGRALS = {
    "deg": _Unit("angular rate", _DEG),
    "rad": _Unit("angular rate", 1.0),
    "m/s": _Unit("acceleration", 1.0),
}  # units of a reading's integral over time, each with the quantity of the reading and its size in SI
_SECONDS = {"s": 1.0, "h": 3600.0}  # in one unit of time

_SPELLINGS = (
    (r"[\u03bc\u00b5]", "u"),  # Greek mu, the micro sign
    ("\u00b0", "deg"),
    ("\u00b2", "^2"),
    ("\u221a", "sqrt"),
    (r"\s", ""),
    (r"/rtHz$", "/sqrt(Hz)"),
    (r"sqrt(\w+)$", r"sqrt(\1)"),
    (r"\((?:hr|hour)\)$", "(h)"),
    (r"(^|\()(m?)dps", r"\1\2deg/s"),
    (r"/hr(?=\)|/|$)", "/h"),
    (r"m/s2", "m/s^2"),
    (r"(?:micro|u)strain|u[e\u03b5](?=$|[/)])", "um/m"),
)


def reading_size(unit: str, reading_unit: str) -> float:
    """Return the size of one `unit`, in reading_unit.

    Raises
    ------
    UsageError
        If a unit is not in the table, or the units have different quantities.
    """
    return _size(unit, reading_unit, _READINGS)


def white_size(unit: str, reading_unit: str) -> float:
    """Return N, two-sided, in reading_unit s^(1/2), of one `unit` of white noise.

    Raises
    ------
    UsageError
        If the unit is not one of white noise, or belongs to another quantity.
    """
    head, root = _split(unit)
    if root == "Hz":
        return _size(head, reading_unit, _READINGS) / math.sqrt(2)
    if head in _READINGS:
        raise UsageError(f"{unit!r} is a unit of a rate random walk, not of white noise; use random_walk.")
    return _size(head, reading_unit, _INTEGRALS) / math.sqrt(_SECONDS[root])


def walk_size(unit: str, reading_unit: str) -> float:
    """Return K, in reading_unit / s^(1/2), of one `unit` of a rate random walk.

    Raises
    ------
    UsageError
        If the unit is not one of a rate random walk, or belongs to another quantity.
    """
    head, root = _split(unit)
    if root == "Hz" or head in _INTEGRALS:
        raise UsageError(f"{unit!r} is a unit of white noise, not of a rate random walk; use white_noise.")
    return _size(head, reading_unit, _READINGS) / math.sqrt(_SECONDS[root])


def _split(unit: str) -> tuple[str, str]:
    """Return the part before the root, and the part within it: Hz, s or h."""
    match = re.fullmatch(r"\(?(.+?)\)?/sqrt\((Hz|s|h)\)", _tidy(unit))
    if match is None:
        raise UsageError(
            f"{unit!r} has no root of hertz or time; write it as ug/sqrt(Hz), deg/sqrt(h) or deg/s/sqrt(h)."
        )
    return match[1], match[2]


def _size(unit: str, reading_unit: str, table: dict[str, _Unit]) -> float:
    """Return the size of one `unit` of a table in units of the readings; both must have the same quantity."""
    one, other = table.get(_tidy(unit)), _READINGS.get(_tidy(reading_unit))
    if one is None:
        raise UsageError(f"{unit!r} is not in the table of units; use one of {', '.join(table)}.")
    if other is None:
        raise UsageError(f"{reading_unit!r} is not a unit of readings; use one of {', '.join(_READINGS)}.")
    if one.quantity != other.quantity:
        raise UsageError(
            f"{unit!r} belongs to {one.quantity}, {reading_unit!r} to {other.quantity}; give units of one quantity."
        )
    return one.size / other.size


def _tidy(unit: str) -> str:
    """Return a unit in the spelling of the tables."""
    for pattern, plain in _SPELLINGS:
        unit = re.sub(pattern, plain, unit)
    return unit
