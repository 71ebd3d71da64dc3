"""Write a filter as C that takes its gains from a table until the gain has settled, without division or covariance."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from becalm.core.arrays import Floats
from becalm.export.design import Design
from becalm.export.expressions import cost_of, in_lines, product_sum
from becalm.export.number_type import NumberType
from becalm.export.schedule import MOST_NUMBERS, Schedule, schedule_of
from becalm.export.settled.word_length import choose_word_length
from becalm.export.shared_parts import WrittenChannel, moved_level, reading_check
from becalm.export.templates import render
from becalm.export.word_length import WordLength

_NEAR = {"float64": 1e-13, "float32": 1e-8}  # parameter `near` of `schedule_of`
_MOST_NUMBERS = {"float64": 8192, "float32": MOST_NUMBERS}  # parameter `most_numbers` of `schedule_of`
_COUNTS = 12  # largest number of counts in a line of C


def write_settled(design: Design, prefix: str, number: NumberType, span: float | None) -> WrittenChannel:
    """Write a filter with a settled gain as C.

    Parameters
    ----------
    design : Design
        The filter.
    prefix : str
        Prefix of the channel's names in C.
    number : NumberType
        Number type of the filter.
    span : float or None
        Largest difference of two readings, in unit; None if unknown. A *small* value leaves more digits, and trusts
        that readings never differ by more.

    Raises
    ------
    RecipeError
        If the filter has no steady state, or the word length of the number type is too short.
    """
    return write_with_gains(
        design, schedule_in(design, number), prefix, number, choose_word_length(design, number, span)
    )


@lru_cache(maxsize=256)
def schedule_in(design: Design, number: NumberType) -> Schedule:
    """Return the schedule of gains of a filter, to the precision of a number type; results are cached."""
    return schedule_of(design, _NEAR[number.precision], _MOST_NUMBERS[number.precision])


def write_with_gains(
    design: Design, schedule: Schedule, prefix: str, number: NumberType, word: WordLength
) -> WrittenChannel:
    """Write a filter with given gains and word length."""
    n, F = design.states, design.model.F
    p, x = [f"p{i}" for i in range(n)], [f"x{i}" for i in range(n)]
    K = np.vstack([schedule.K, schedule.settled])
    gains = np.column_stack([K @ F.T, K @ design.output])
    counted = 0 if schedule.exact else len(schedule.counts)
    largest = min(design.largest, number.greatest, word.range if word.quantum else np.inf)
    context = {
        **reading_check(design, prefix, number, largest),
        "o": len(design.opening.weights),
        "opening": _literals(design.opening.weights, number),
        "gains": _literals(gains, number),
        "settled": [number.literal(value) for value in gains[-1].tolist()],
        "table": len(gains) > 1,
        "exact": schedule.exact,
        "counts": in_lines((f"{count}u" for count in schedule.counts.tolist()), _COUNTS),
        "coasts": design.coasts,
        **moved_level(word.quantum, number, design),
        "read_of_p": product_sum(design.model.H[0], p, number),
        "signal_of_p": product_sum(design.output, p, number),
        "signal_of_x": product_sum(design.output, x, number),
        "ahead_of_p": [product_sum(row, p, number) for row in F],
        "ahead_of_x": [product_sum(row, x, number) for row in F],
    }
    source = render("settled.c.jinja", context)
    return WrittenChannel(
        header=render("settled.h.jinja", context),
        source=source,
        cost=cost_of(_settled_row(source)),
        state_bytes=_bytes(design, schedule, number),
        table_bytes=(gains.size + design.opening.weights.size) * number.bytes + 4 * counted,
        word=word,
        largest=largest,
        exact=schedule.exact,
        start_rows=len(design.opening.weights) + schedule.rows,
    )


def _settled_row(source: str) -> list[str]:
    """Return the C lines that run for a row in the steady state."""
    lines = source.splitlines()
    first = max(i for i, line in enumerate(lines) if line.lstrip().startswith("const") and " nu = " in line)
    return lines[first : next(i for i in range(first, len(lines)) if "} else {" in lines[i])]


def _literals(rows: Floats, number: NumberType) -> list[list[str]]:
    return [[number.literal(value) for value in row] for row in rows.tolist()]


def _bytes(design: Design, schedule: Schedule, number: NumberType) -> int:
    """Return the size of the state in bytes, including the padding that a compiler adds."""
    size = (design.states + 1) * number.bytes + 4 + 4 * (not schedule.exact)
    if design.limits.stuck_readings:
        size = -(-size // number.bytes) * number.bytes + 3 * number.bytes + 4
    return -(-size // number.bytes) * number.bytes
