"""Write the parts that all filters in C have: names with units, and the check of each reading."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np

from becalm.export.design import Design
from becalm.export.expressions import OperationCount
from becalm.export.naming import comment, identifier
from becalm.export.number_type import NumberType
from becalm.export.templates import render
from becalm.export.word_length import WordLength

_SPELT = (("/", " per "), ("%", " percent "), ("°", " deg "), ("^", ""), ("²", "2"), ("³", "3"), ("√", " sqrt "))

FOLDER = "native"
"""Folder of the library's C sources in a bundle."""


class WrittenChannel(NamedTuple):
    """One channel as C text.

    Attributes
    ----------
    header, source : str
        C texts of the state's type, and of the functions.
    cost : OperationCount or None
        Operations of a row in the steady state; None for the library's own channel, whose rows differ.
    state_bytes, table_bytes : int
        Size of the state in memory, and of the constants in program memory, in bytes.
    word : WordLength or None
        Error of the word length; None for the library's own channel, which computes in double.
    largest : float
        Magnitude beyond which a value is overrange, in unit.
    exact : bool
        Whether the filter equals becalm's filter from the first reading on, as long as no reading is missing.
    start_rows : int
        Number of rows, without missing readings, until the gain has settled; 0 if it does not settle.
    scale : (float, float) or None
        Offset and least significant bit (lsb) of counts, in unit; None if readings are not counts.
    """

    header: str
    source: str
    cost: OperationCount | None
    state_bytes: int
    table_bytes: int
    word: WordLength | None
    largest: float
    exact: bool
    start_rows: int = 0
    scale: tuple[float, float] | None = None


def channel_context(design: Design, prefix: str, number: NumberType) -> dict[str, Any]:
    """Return the names, types and constants that all templates of a channel need."""
    unit = unit_name(design.unit)
    context = {
        "p": prefix,
        "n": design.states,
        "real": number.name,
        "zero": f"0.0{number.suffix}",
        "one": f"1.0{number.suffix}",
        "unit_words": comment(design.unit) or "in the unit of readings",
        "reading": f"reading_{unit}" if unit else "reading",
        "signal": f"signal_{unit}" if unit else "signal",
    }
    return context | {"block": render("block.c.jinja", context)}


def reading_check(design: Design, prefix: str, number: NumberType, largest: float) -> dict[str, Any]:
    """Return the values that templates need to check a reading, and the C function that checks it."""
    limits = design.limits
    rails = []
    if np.isfinite(limits.low):
        rails.append(f"(z <= {_signed(number, number.below(limits.low))})")
    if np.isfinite(limits.high):
        rails.append(f"(z >= {_signed(number, number.above(limits.high))})")
    context = {
        **channel_context(design, prefix, number),
        "largest": number.literal(number.below(largest)),
        "stuck": min(limits.stuck_readings or 0, (1 << 32) - 1),
        "rails": " || ".join(rails),
    }
    return context | {"look": render("look.c.jinja", context)}


def also_level(design: Design) -> list[int]:
    """Return the indices of the states, without the first, that grow by 1 if the level of the signal grows by 1."""
    return [int(state) for state in np.flatnonzero(design.level_direction)[1:]]


def moved_level(quantum: float | None, number: NumberType, design: Design) -> dict[str, Any]:
    """Return the values that templates need to move the level by whole quanta; they are None if the level is fixed."""
    if quantum is None:
        return {"quantum": None, "per_quantum": None, "farthest": None}
    return {
        "also_level": also_level(design),
        "quantum": number.literal(quantum),
        "per_quantum": number.literal(1 / quantum),
        "farthest": number.literal(quantum * 2.0**30),
    }


def unit_name(unit: str) -> str:
    """Return a unit as a part of a C name, such as `m_per_s2`."""
    for sign, spelt in _SPELT:
        unit = unit.replace(sign, spelt)
    name = identifier(unit, "")
    return re.sub(r"_+", "_", name).strip("_")


def _signed(number: NumberType, value: float) -> str:
    literal = number.literal(value)
    return f"({literal})" if literal.startswith("-") else literal
