"""A bank of filters that switches as C: constants in tables, loops over modes and states, its own exp and root.

All is scaled by a power of two near the noise of the mode that is read most finely, so that float keeps its range and
double its bits.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.possible import largest_level
from becalm.core.reach import Reach, least_reach, reach_of
from becalm.core.switching import Switching
from becalm.errors import RecipeError
from becalm.export.design import Design
from becalm.export.expressions import in_lines
from becalm.export.factors import factors_of
from becalm.export.kind import Span
from becalm.export.naming import identifiers
from becalm.export.number_type import NumberType
from becalm.export.row_cost import row_cost
from becalm.export.templates import render
from becalm.export.word_length import COUNTED
from becalm.export.written import Written, also_level, look_of

MOST_ROWS = (1 << 17) - 1
"""Rows of one gap that are stepped through; after more the next reading begins anew."""

_COUNTABLE = (1 << 32) - 1
_LN2 = 0.6931471805599453, 2.3190468138462996e-17  # the nearest double, and the rest
_PARTS_OF_SPAN = 1 << 30
_ROUNDED = 1e3  # of a noise, to which a reading is rounded that is none: see `becalm.core.possible`
_COARSEST, _QUANTUM, _FINEST = 0.5, 0.25, 2.0**-6  # of the scale: by what a level of float moves, the second unasked
_START = 2.0**-56  # of what is unknown at the start, which double rounds off there: up to a third of it was measured
_ON_A_LINE = 4
_SMALLEST, _GREATEST = 1e-20, 1e15  # of a noise in float, unit: signals and squares keep its range


class _Bounds(NamedTuple):
    """What keeps a number type from overflow and underflow; in parts of the scale, or of its square."""

    unlikely: float  # no mode becomes less probable
    impossible: float  # no likelihood below it tells of modes
    greatest: float
    largest_state: float
    largest_variance: float


class _Exponential(NamedTuple):
    """How exp and the root are made of bits."""

    unsigned: str
    digits: int  # of a significand, but for the first
    bias: int
    cut: float
    terms: int
    root_bits: int
    root_steps: int


_BOUNDS = {
    "float64": _Bounds(1e-100, 1e-300, 1e300, 1e100, 1e200),
    "float32": _Bounds(1e-20, 1e-36, 1e38, 1e15, 1e30),
}
_EXPONENTIALS = {
    "float64": _Exponential("uint64_t", 52, 1023, 708.0, 14, 0x5FE6EB50C7B537A9, 4),
    "float32": _Exponential("uint32_t", 23, 127, 87.0, 8, 0x5F375A86, 3),
}


def written_bank(design: Design, prefix: str, number: NumberType, span: Span | None) -> Written:
    """Write a bank.

    Parameters
    ----------
    design : Design
        A channel whose recipe switches.
    prefix : str
        What its names in C begin with.
    number : NumberType
        What it computes in.
    span : (float, float) or None
        Least and greatest reading, in unit; a *small* one lets float follow the level more finely.

    Raises
    ------
    RecipeError
        If float cannot hold its numbers.

    Notes
    -----
    Double carries covariances as becalm does, float in factors, U D U': whole, it would lose what is known beside what
    is not, in the first rows and after gaps.
    """
    modes = _modes_of(design)
    scale = scale_of(design)
    if not number.is_double:
        _refuse_beyond_float(design, scale)
    largest = largest_of(design, number)
    context = {
        **look_of(design, prefix, number, largest),
        **_tables(modes, scale, number),
        **_level(design, scale, number, span),
        **_memory(reach_of_bank(modes)),
        **{name: number.literal(value) for name, value in _BOUNDS[number.precision]._asdict().items()},
        "mode_names": _mode_names(modes, prefix),
        "keeps_level": modes.component.keeps_level,
        "also_level": also_level(design),
        "scale_words": f"{scale:.9g}",
        "per_scale": number.literal(1 / scale),
        "scale": number.literal(scale),
        "half": number.literal(0.5),
        "faint": number.literal(2.0**-number.bits),
        "gathered": number.literal(2.0**-20),
        "seldom": number.literal(1e-8),
        "most_rows": MOST_ROWS,
    }
    context["exponential"] = render("exponential.c.jinja", {**context, **exponential_of(number)})
    context["carried_on"] = render("bank_whole.c.jinja" if number.is_double else "bank_factors.c.jinja", context)
    source = render("bank.c.jinja", context)
    return Written(
        header=render("bank.h.jinja", context),
        source=source,
        cost=row_cost(source, [f"{prefix}_{name}" for name in ("ahead", "take", "relevel", "merged")]),
        state_bytes=_state_bytes(design, bool(context["carried"]), number),
        table_bytes=_table_bytes(modes, bool(context["tails"]), number),
        word=None,
        largest=largest,
        exact=True,
        start_error=_START * float(modes.start[:, 1:].max()) / design.noise_std if number.is_double else 0.0,
    )


def scale_of(design: Design) -> float:
    """Return what states are told in parts of, in unit: the power of two nearest the least noise of all modes."""
    return float(2.0 ** np.round(np.log2(design.noise_std)))


def largest_of(design: Design, number: NumberType) -> float:
    """Return the magnitude beyond which a value is no reading, in unit; in float a noise has fewer digits beside it."""
    rounded = np.inf if number.is_double else _ROUNDED * design.noise_std * 2.0 ** (number.bits - 1)
    return float(min(design.largest, number.greatest, rounded))


def reach_of_bank(modes: Switching) -> Reach:
    """Return which gaps a bank is carried across: those that each of its modes bridges."""
    return least_reach([reach_of(mode.component, mode.noise_variance) for mode in modes.modes])


def exponential_of(number: NumberType) -> dict[str, Any]:
    """Return what the template of exp and the root needs."""
    told = _EXPONENTIALS[number.precision]
    parts = 2.0 ** (told.digits + 2)
    whole = round(_LN2[0] * parts)
    factorials = [1.0]
    for k in range(1, told.terms):
        factorials.insert(0, factorials[0] / k)
    return {
        "unsigned": told.unsigned,
        "digits": told.digits,
        "bias": told.bias,
        "terms": told.terms,
        "inverse_factorials": in_lines(map(number.literal, factorials), _ON_A_LINE),
        "least_exponential": f"{np.exp(-told.cut):.1e}",
        "exponent_cut": number.literal(told.cut),
        "per_ln2": number.literal(1 / _LN2[0]),
        "per_part": number.literal(parts),
        "part": number.literal(1 / parts),
        "ln2_parts": f"{whole}u",
        "ln2_rest": number.literal((_LN2[0] - whole / parts) + _LN2[1]),
        "root_bits": f"0x{told.root_bits:X}u",
        "root_steps": told.root_steps,
    }


def _modes_of(design: Design) -> Switching:
    assert design.modes is not None
    return design.modes


def _refuse_beyond_float(design: Design, scale: float) -> None:
    """Raise a RecipeError where float has no room for a bank's numbers."""
    modes, most = _modes_of(design), _BOUNDS["float32"].largest_variance
    if not _SMALLEST <= scale <= _GREATEST:
        raise RecipeError(
            f"{design.name} has a noise of {design.noise_std:.3g}{design.unit_after}, and float has room for"
            f" {_SMALLEST:.0e} to {_GREATEST:.0e}; use --precision float64, or a unit nearer to its size."
        )
    bank = modes.bank(np.ones(1))
    greatest = max(float(np.abs(part).max()) for part in (bank.Q, bank.R, bank.wild[:1])) / scale**2
    if not greatest <= most:
        raise RecipeError(
            f"{design.name} has a mode with a variance of {greatest:.3g} times that of the quietest reading, and float"
            f" has room for {most:.0e}; use --precision float64, or mend the recipe's modes."
        )


def _tables(modes: Switching, scale: float, number: NumberType) -> dict[str, Any]:
    """Return the constants of a bank, for one step."""
    bank, unit = modes.bank(np.ones(1)), scale**2
    start = modes.start.copy()
    start[:, 1:] = np.minimum(start[:, 1:] / unit, _BOUNDS[number.precision].largest_variance)
    return {
        "M": len(modes.modes),
        "F": _nested(bank.F, number),
        "Q": _nested(bank.Q / unit if number.is_double else np.array([_columns(Q) for Q in bank.Q / unit]), number),
        "factored": not number.is_double,
        "P": "P" if number.is_double else "U",
        "columns": len(modes.modes) * (modes.states + 1) + modes.states,
        "T": _nested(bank.T[0], number),
        "leaves": _braced((bank.T[0] * (1 - np.eye(len(modes.modes)))).sum(axis=1), number),
        "start": _nested(start, number),
        "H": _braced(bank.H[0], number),
        "C": _braced(bank.C[0], number),
        "R": _braced(bank.R / unit, number),
        "tail": _braced(bank.tail, number),
        "tails": bool(bank.tail.any()),
        "rejects": bool(bank.tail.any()) and modes.rejects,
        "V": number.literal(float(bank.wild[0]) / unit),
    }


def _level(design: Design, scale: float, number: NumberType, span: Span | None) -> dict[str, Any]:
    """Return how the level is chosen: in double the first reading, in float what moves by whole quanta."""
    if number.is_double or not _modes_of(design).component.keeps_level:
        return {"quantum": None, "largest_level": number.literal(number.below(largest_level(design.noise_variance)))}
    quantum = _QUANTUM
    if span is not None:
        counted = max(map(abs, span)) / scale / COUNTED
        quantum = float(np.clip(2.0 ** np.ceil(np.log2(max(counted, _FINEST))), _FINEST, _COARSEST))
    return {
        "quantum": number.literal(quantum),
        "per_quantum": number.literal(1 / quantum),
        "most_quanta": number.literal(2.0**30),
        "largest_level": number.literal(COUNTED * quantum * scale),
    }


def _memory(reach: Reach) -> dict[str, Any]:
    """Return what is counted to know whether a gap is beyond reach; a span as far as it matters."""
    longest = int(min(reach.longest, _COUNTABLE))
    carried = bool(np.isfinite(reach.spans))
    return {
        "longest": longest,
        "told": reach.readings if carried else 1,
        "carried": round(reach.spans * _PARTS_OF_SPAN) if carried else 0,
        "longest_span": int(min(longest / reach.spans + 2, _COUNTABLE >> 1)) if carried else 0,
    }


def _mode_names(modes: Switching, prefix: str) -> list[str]:
    return [f"{prefix}_{name}".upper() for name in identifiers([mode.name for mode in modes.modes], "mode")]


def _state_bytes(design: Design, carried: bool, number: NumberType) -> int:
    """Return the size of the state, as a compiler lays it out."""
    n, M = design.states, len(_modes_of(design).modes)
    size = (M * (n + n * n + 1) + 1) * number.bytes + 8 + 4 * carried
    if design.limits.stuck_readings:
        size = -(-size // number.bytes) * number.bytes + 3 * number.bytes + 4
    return -(-size // number.bytes) * number.bytes


def _table_bytes(modes: Switching, tails: bool, number: NumberType) -> int:
    n, M = modes.states, len(modes.modes)
    of_modes = M * (2 + tails + (not number.is_double) + n)
    numbers = 2 * M * n * n + M * M + 2 * n + of_modes + _EXPONENTIALS[number.precision].terms
    return numbers * number.bytes


def _columns(Q: Floats) -> Floats:
    """Return the factors of a covariance (n, n) as C holds them: each row a column of U, with D in place of its 1."""
    U, D = factors_of(Q)
    columns = U.T.copy()
    np.fill_diagonal(columns, D)
    return columns


def _nested(values: Floats, number: NumberType) -> list[str]:
    """Write the rows of a matrix, or the matrices of a stack, each in braces."""
    return [_braced(row, number) for row in values]


def _braced(values: Floats, number: NumberType) -> str:
    if values.ndim == 1:
        return f"{{ {', '.join(number.literal(value) for value in values.tolist())} }}"
    return f"{{ {', '.join(_braced(row, number) for row in values)} }}"
