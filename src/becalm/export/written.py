"""What every filter in C has, whatever its mathematics: names with their units, and a look at each reading."""

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
"""Where files of the library lie in a bundle."""


class WrittenChannel(NamedTuple):
    """One channel in C.

    Attributes
    ----------
    header, source : str
        The type of its state, and its functions.
    cost : OperationCount or None
        Of a settled row; None of the library's channel, whose rows differ.
    state_bytes, table_bytes : int
        Of its state in memory, and of its gains in program memory.
    word : WordLength or None
        What its word length costs; None of the library's channel, which is in double.
    largest : float
        Magnitude beyond which a value is no reading, in unit.
    exact : bool
        Whether it is the filter of becalm from its first reading on, as long as none is missing.
    start_rows : int
        Rows until its gain has settled.
    scale : (float, float) or None
        Offset and step of a count, in unit; None where readings are no counts.
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


def words_of(design: Design, prefix: str, number: NumberType) -> dict[str, Any]:
    """Return the names that templates use."""
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


def look_of(design: Design, prefix: str, number: NumberType, largest: float) -> dict[str, Any]:
    """Return what templates need to look at a reading, and the function that does."""
    limits = design.limits
    rails = []
    if np.isfinite(limits.low):
        rails.append(f"(z <= {_signed(number, number.below(limits.low))})")
    if np.isfinite(limits.high):
        rails.append(f"(z >= {_signed(number, number.above(limits.high))})")
    context = {
        **words_of(design, prefix, number),
        "largest": number.literal(number.below(largest)),
        "stuck": min(limits.stuck_readings or 0, (1 << 32) - 1),
        "rails": " || ".join(rails),
    }
    return context | {"look": render("look.c.jinja", context)}


def also_level(design: Design) -> list[int]:
    """Return which states, beside the first, a constant is added to when it is added to the signal."""
    return [int(state) for state in np.flatnonzero(design.level_direction)[1:]]


def moved_level(quantum: float | None, number: NumberType, design: Design) -> dict[str, Any]:
    """Return what templates need to move a level by whole quanta, in unit; nothing where it stays."""
    if quantum is None:
        return {"quantum": None, "per_quantum": None, "farthest": None}
    return {
        "also_level": also_level(design),
        "quantum": number.literal(quantum),
        "per_quantum": number.literal(1 / quantum),
        "farthest": number.literal(quantum * 2.0**30),
    }


def unit_name(unit: str) -> str:
    """Return a unit as a part of a name in C, as `m_per_s2`."""
    for sign, spelt in _SPELT:
        unit = unit.replace(sign, spelt)
    name = identifier(unit, "")
    return re.sub(r"_+", "_", name).strip("_")


def _signed(number: NumberType, value: float) -> str:
    literal = number.literal(value)
    return f"({literal})" if literal.startswith("-") else literal
