"""Write a filter with a settled gain in fixed point as C: 64-bit integers, and products of 32 by 32 bits."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.export.design import Design
from becalm.export.expressions import OperationCount, in_lines
from becalm.export.fixed.word_length import BinaryPoint, fit
from becalm.export.number_type import DOUBLE, NumberType
from becalm.export.schedule import Schedule, schedule_of
from becalm.export.shared_parts import WrittenChannel, channel_context, unit_name
from becalm.export.templates import render

GREATEST = (1 << 31) - 1
"""Largest number of counts, at which a reading or the signal saturates."""

_NEAR = 1e-9  # parameter `near` of `schedule_of`, for gains of 31 bits
_FARTHEST = 92  # largest shift; with a larger one, nothing remains of a number of 62 bits
_ON_A_LINE = 12  # largest number of numbers in a line of C


class Scale(NamedTuple):
    """The scale of counts: reading = offset + lsb * counts, in unit. A reading of 0 in the range is a whole count."""

    offset: float
    lsb: float

    def in_unit(self, counts: int) -> float:
        """Return a number of counts in unit."""
        return self.offset + self.lsb * counts

    def counts(self, values: Floats) -> Floats:
        """Return values (N,), in unit, as counts, which are saturated but not rounded."""
        with np.errstate(over="ignore"):
            return np.clip((values - self.offset) / self.lsb, -float(GREATEST), float(GREATEST))


class CountLimits(NamedTuple):
    """The limits of readings, in counts."""

    low: int  # readings at or below it are clipped
    high: int  # readings at or above it are clipped
    least: int  # readings below it are overrange
    most: int  # readings above it are overrange


def scale_of(low: float, high: float) -> Scale:
    """Return the scale of readings from low to high, in unit."""
    lsb = (high - low) / 2.0**32
    return Scale(float(np.rint((high + low) / 2 / lsb)) * lsb, lsb)


def count_limits_of(design: Design, scale: Scale) -> CountLimits:
    """Return the limits of a channel's readings in counts, each at most `GREATEST` in magnitude."""
    limits, largest = design.limits, design.largest
    return CountLimits(
        _at_most(limits.low, scale),
        -_at_most(-limits.high, Scale(-scale.offset, scale.lsb)),
        -_at_most(largest, Scale(-scale.offset, scale.lsb)),
        _at_most(largest, scale),
    )


def _at_most(value: float, scale: Scale) -> int:
    """Return the greatest number of counts whose reading is not above a value; at most `GREATEST` in magnitude."""
    near = round(float(scale.counts(np.array([value]))[0]))
    while near < GREATEST and scale.in_unit(near + 1) <= value:
        near += 1
    while near > -GREATEST and scale.in_unit(near) > value:
        near -= 1
    return near


@lru_cache(maxsize=256)
def schedule_in(design: Design) -> Schedule:
    """Return the schedule of gains of a filter, for gains of 31 bits."""
    return schedule_of(design, _NEAR)


def write_fixed(design: Design, prefix: str, number: NumberType, span: tuple[float, float]) -> WrittenChannel:
    """Write a filter in fixed point as C.

    Parameters
    ----------
    design : Design
        The filter.
    prefix : str
        Prefix of the channel's names in C.
    number : NumberType
        Number type of a reading.
    span : (float, float)
        Least and greatest reading, in unit.

    Raises
    ------
    RecipeError
        If the filter has no steady state, or the range of readings is too wide for the word length.
    """
    schedule, scale = schedule_in(design), scale_of(*span)
    point, word = fit(design, schedule, scale.lsb)
    limits, n = count_limits_of(design, scale), design.states
    context = {
        **channel_context(design, prefix, number),
        **_numbers(design, schedule, point),
        **_limit_context(design, scale, limits),
        "offset": DOUBLE.literal_with_comment(scale.offset),
        "lsb": DOUBLE.literal_with_comment(scale.lsb),
        "counted": "_".join([prefix, "{}", unit_name(design.unit)]).rstrip("_").upper(),
        "coasts": design.coasts,
        "exact": schedule.exact,
    }
    source = render("fixed.c.jinja", context)
    gains = len(schedule.K) + 1
    return WrittenChannel(
        header=render("fixed.h.jinja", context),
        source=source,
        cost=_cost(source),
        state_bytes=_bytes(design, schedule),
        table_bytes=5 * (gains * (n + 1) + design.opening.weights.size) + 4 * (not schedule.exact) * (gains - 1),
        word=word,
        largest=min(design.largest, max(abs(scale.in_unit(-GREATEST)), abs(scale.in_unit(GREATEST)))),
        exact=schedule.exact,
        start_rows=len(design.opening.weights) + schedule.rows,
        scale=(scale.offset, scale.lsb),
    )


def _limit_context(design: Design, scale: Scale, limits: CountLimits) -> dict[str, Any]:
    """Return the values that templates need to check a reading."""
    zero = round(float(scale.counts(np.zeros(1))[0]))
    return {
        "low": limits.low,
        "high": limits.high,
        "least": limits.least,
        "most": limits.most,
        "possible": limits.least == -GREATEST and limits.most == GREATEST,
        "nothing": zero,
        "rests": scale.in_unit(zero) == 0.0,
        "stuck": min(design.limits.stuck_readings or 0, (1 << 32) - 1),
    }


def _numbers(design: Design, schedule: Schedule, point: BinaryPoint) -> dict[str, Any]:
    """Return the values that templates need for the filter: its coefficients, and the terms of its sums as C."""
    F, H, C, n = design.model.F, design.model.H[0], design.output, design.states
    f, nu, signal = np.array(point.states), point.innovation, point.signal
    p, x = [f"p{i}" for i in range(n)], [f"x{i}" for i in range(n)]
    K = np.vstack([schedule.K, schedule.settled])
    gains = np.column_stack([K @ F.T * 2.0 ** (f - nu), K @ C * 2.0 ** (signal - nu)])
    transition = F * 2.0 ** (f[:, np.newaxis] - f)  # F between states with different binary points
    return {
        "o": len(design.opening.weights),
        "x": x,
        "a": [f"a{i}" for i in range(n)],
        "opening": _table(design.opening.weights * 2.0 ** (f - nu)),
        "gains": _table(gains),
        "rows": len(K),
        "counts": in_lines((f"{count}u" for count in schedule.counts.tolist()), _ON_A_LINE),
        "digits": point.states,
        "innovation_digits": nu,
        "signal_digits": signal,
        "of_reading": 1 << nu,
        "of_level": {i: f"INT64_C({1 << point.states[i]})" for i in np.flatnonzero(design.level_direction).tolist()},
        "read_of_p": terms(-H * 2.0 ** (nu - f), p),
        "signal_of_p": terms(C * 2.0 ** (signal - f), p),
        "signal_of_x": terms(C * 2.0 ** (signal - f), x),
        "ahead_of_p": [terms(row, p) for row in transition],
        "ahead_of_x": [terms(row, x) for row in transition],
    }


def factor_of(value: float) -> tuple[int, int]:
    """Return (m, s), m of 31 bits, with m / 2^s closest to a value; m is 0 if the product with 62 bits would be 0."""
    fraction, exponent = np.frexp(value)
    mantissa, shift = round(float(fraction) * 2.0**31), 31 - int(exponent)
    if abs(mantissa) > GREATEST:
        mantissa, shift = mantissa // 2, shift - 1
    return (mantissa, shift) if mantissa and shift <= _FARTHEST else (0, 31)


def round_to_factors(values: Floats) -> Floats:
    """Return values, each rounded to m / 2^s with m of 31 bits."""
    factors = [factor_of(value) for value in values.ravel().tolist()]
    return np.array([mantissa / 2.0**shift for mantissa, shift in factors]).reshape(values.shape)


def terms(row: Floats | Sequence[float], names: Sequence[str]) -> list[str]:
    """Write the terms row[j] * names[j] in integers; a factor that 31 bits do not represent exactly gets two terms."""
    written = []
    for value, name in zip(row, names, strict=True):
        remainder = float(value)
        for _ in range(2):
            mantissa, shift = factor_of(remainder)
            if mantissa:
                written.append(_term(mantissa, shift, name))
            remainder -= mantissa / 2.0**shift
    return written or ["INT64_C(0)"]


def _term(mantissa: int, shift: int, name: str) -> str:
    if abs(mantissa) != 1 << 30 or shift < 30:
        return f"becalm_times({name}, {mantissa}, {shift}u)"
    sign = "-" if mantissa < 0 else ""
    return f"{sign}{name}" if shift == 30 else f"{sign}becalm_rounded({name}, {shift - 30}u)"


def _table(rows: Floats) -> dict[str, list[list[str]]]:
    """Return m and s of each coefficient (r, k), as in `factor_of`, row by row."""
    factors = [[factor_of(value) for value in row] for row in rows.tolist()]
    return {
        "mantissas": [[str(mantissa) for mantissa, _ in row] for row in factors],
        "shifts": [[f"{shift}u" for _, shift in row] for row in factors],
    }


def _cost(source: str) -> OperationCount:
    """Count the operations of a row in the steady state; a call of becalm_times is two products and two additions."""
    lines = source.splitlines()
    first = next(i for i, line in enumerate(lines) if line.lstrip().startswith("int64_t nu = "))
    row = "\n".join(lines[first : next(i for i in range(first, len(lines)) if "s->p[0] = " in lines[i])])
    products, sums, rounded = (len(re.findall(rf"becalm_{name}\(", row)) for name in ("times", "sum", "rounded"))
    return OperationCount(2 * products, 2 * products + sums + rounded + 1)  # the last operation rounds the signal


def _bytes(design: Design, schedule: Schedule) -> int:
    """Return the size of the state in bytes for a compiler that aligns 64-bit integers to 64 bits."""
    size = 8 * design.states + 8 + 4 * (not schedule.exact) + 16 * bool(design.limits.stuck_readings)
    return -(-size // 8) * 8
