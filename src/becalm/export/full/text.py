"""A filter with its full covariance as C: gains as they follow from what came, constants once they have settled."""

from __future__ import annotations

from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.gates import GOES_ON, WIDE, level_of
from becalm.core.possible import largest_level
from becalm.export.design import Design
from becalm.export.expressions import Cost, in_lines
from becalm.export.factors import factors_of
from becalm.export.number_type import DOUBLE, NumberType
from becalm.export.row_cost import row_cost
from becalm.export.templates import render
from becalm.export.word_length import COUNTED, WordLength, noise_of, stall_of, start_of
from becalm.export.written import Written, look_of, moved_level

_ON_A_LINE = 4
_NEVER = (1 << 32) - 1
_MOST_SINGLE = 1 << 14  # rows of a gap while rejects wait
_HIGHEST_IN_FLOAT = 3  # order of motion
_STALLED, _ADDED = 1e-5, 3e-7  # of a reading's noise: what a state of float may stall off, and what it may add
_STARTED = 1e-4  # of a reading's noise: what may be left of the first signals
_QUANTUM = 0.5  # of a reading's noise: by so much the level moves
_GREATEST = {"float32": 3e38, "float64": 1e300}
_ROUNDED_ULPS = {"float32": 1 << 24, "float64": 1 << 6}  # of a square of double: what rounding leaves of an innovation


def written_full(design: Design, prefix: str, number: NumberType, span: float | None) -> Written:
    """Write a filter that carries its covariance.

    Parameters
    ----------
    design : Design
        The filter.
    prefix : str
        What its names in C begin with.
    number : NumberType
        What readings are, and states where that costs nothing. The covariance is in double whatever they are, as
        factors: in float it would lose all digits of a gain of order 5 before it settles.
    span : float or None
        How far readings lie from each other at the most, in unit; a *small* one lets the level of float move more
        finely, and trusts that they never lie farther apart: beyond, they are overrange. None where nobody said.
    """
    inner, word = _inner(design, number, span)
    quantum = word.quantum if word else None
    largest = min(design.largest, number.greatest, word.range if word and quantum else np.inf)
    held = largest_level(design.noise_variance)
    context = {
        **look_of(design, prefix, number, largest),
        **moved_level(quantum, inner, design),
        **_model(design),
        **_of_state(design, inner),
        **_ends(design),
        "num": inner.name,
        "nought": inner.literal(0.0),
        "inward": "" if inner == number else "(double)",
        "outward": "" if inner == number else "(float)",
        "double": inner.is_double,
        "most": inner.literal(inner.greatest),
        "largest_level": inner.literal(held) if inner.is_double and held < largest else None,
        "most_d": DOUBLE.literal(inner.greatest),
        "greatest": number.literal(_GREATEST[number.precision]),
        "greatest_d": DOUBLE.literal(_GREATEST[number.precision]),
        **_gate(design, inner),
    }
    context["covariance_c"] = render("covariance.c.jinja", context)
    context["gate_c"] = render("gate.c.jinja", context) if design.gate else ""
    source = render("full.c.jinja", context)
    return Written(
        header=render("full.h.jinja", context),
        source=source,
        cost=_cost(design, source, prefix, context["noises"]),
        state_bytes=_bytes(design, number, inner),
        table_bytes=_table_bytes(design, inner, context["noises"]),
        word=word,
        largest=largest,
        exact=True,
        start_rows=len(design.opening.weights) + design.settled_rows if design.settles else 0,
    )


def _packed(P: Floats) -> Floats:
    """Return the factors of a covariance as C holds them: the upper triangle column by column, D on its diagonal."""
    held, D = factors_of(P)
    np.fill_diagonal(held, D)  # in the place of the 1s: a small one must not lose its digits to them
    return np.concatenate([held[: j + 1, j] for j in range(len(P))])


def _settled_cov(design: Design) -> Floats:
    """Return the covariance after a reading, once settled, in parts of R, by (7)."""
    assert design.steady is not None
    P, K, R = design.steady.predicted_cov, design.steady.gain, design.noise_variance
    A = np.eye(design.states) - K @ design.model.H
    return np.asarray(A @ (P / R) @ A.T + K @ K.T, dtype=np.float64)


def _inner(design: Design, number: NumberType, span: float | None) -> tuple[NumberType, WordLength | None]:
    """Return what states are, and what their word costs: float only where it costs next to nothing beside a reading.

    Rounding of a slow filter, or of a motion whose order is high, would add up beyond a millionth of the signal.
    """
    if number.is_double or design.steady is None or not design.settles or design.motion_order > _HIGHEST_IN_FLOAT:
        return DOUBLE, None
    quantum = 2.0 ** np.floor(np.log2(_QUANTUM * design.noise_std))
    if span is not None and span > quantum * COUNTED:
        quantum = 2.0 ** np.ceil(np.log2(span / COUNTED))
    stall, noise = stall_of(design, number, quantum), noise_of(design, number, quantum)
    kept = stall <= _STALLED * design.noise_std and noise <= _ADDED * design.noise_std
    if not (kept and start_of(design, number) <= _STARTED * design.noise_std):
        return DOUBLE, None
    share = max(stall, noise) / design.settled_std
    return number, WordLength(stall, noise, share, float(quantum) * COUNTED, float(quantum))


def _model(design: Design) -> dict[str, Any]:
    """Return the constants of the covariance, in double."""
    n, model, R = design.states, design.model, design.noise_variance
    G, Q = factors_of(model.process_covariance / R)
    drives = Q > 0
    return {
        "packed": n * (n + 1) // 2,
        "noises": int(drives.sum()),
        "F": _table(model.F, DOUBLE),
        "G": _table(G[:, drives], DOUBLE),
        "Q": _table(Q[drives], DOUBLE),
        "H": _table(model.H[0], DOUBLE),
        "C": _table(design.output, DOUBLE),
        "variance": DOUBLE.literal(R),
        "longest": design.longest_gap if design.longest_gap < _NEVER else None,
        "opened": _table(_packed(design.opening.P / R), DOUBLE),
    }


def _of_state(design: Design, number: NumberType) -> dict[str, Any]:
    """Return the constants of the state, as its numbers are."""
    return {
        "o": len(design.opening.weights),
        "opening": _table(design.opening.weights, number),
        "F_real": _table(design.model.F, number),
        "H_real": _table(design.model.H[0], number),
        "C_real": _table(design.output, number),
        "gain": _table(design.steady.gain, number) if design.steady is not None else None,
    }


def _ends(design: Design) -> dict[str, Any]:
    """Return what stays once the gain has settled."""
    if design.steady is None or not design.settles:
        return {"settled": False}
    return {
        "settled": True,
        "settled_rows": design.settled_rows,
        "covariance": _table(_packed(_settled_cov(design)), DOUBLE),
        "settled_S": DOUBLE.literal(design.steady.innovation_variance / design.noise_variance),
    }


def _gate(design: Design, number: NumberType) -> dict[str, Any]:
    """Return the constants of a gate."""
    gate, model, R = design.gate, design.model, design.noise_variance
    if gate is None:
        return {"gate": False}
    level, H = level_of(model), model.H
    return {
        "gate": True,
        "threshold2": DOUBLE.literal(gate.threshold**2),
        "agree": gate.agree,
        "at_most": gate.at_most,
        "goes_on": GOES_ON,
        "least_since": min(gate.at_most, (1 << 31) - 1),
        "level": level if level >= 0 else None,
        "level_variance": DOUBLE.literal(R / float(H[0, level]) ** 2) if level >= 0 else None,
        "wide": DOUBLE.literal(WIDE),
        "per_noise": DOUBLE.literal(1 / design.noise_std),
        "per_variance": DOUBLE.literal(1 / R),
        "moves": _table((H @ model.F - H)[0], DOUBLE),
        "moves_noise": DOUBLE.literal(float((H @ model.process_covariance @ H.T)[0, 0]) / R),
        "rounded_ulps": _ROUNDED_ULPS[number.precision],
        "most_single": _MOST_SINGLE,
    }


def _table(values: Floats, number: NumberType) -> dict[str, Any]:
    """Return numbers as lines of literals, and how many there are."""
    words = [number.literal(value) for value in np.ravel(values).tolist()]
    return {"count": len(words), "lines": in_lines(words, _ON_A_LINE)}


def _cost(design: Design, source: str, prefix: str, noises: int) -> Cost:
    """Count the operations of a row: of a settled one, or of a full one where none settles; without rejects."""
    seldom = ["at", "exact", "jump", "reject", "wander", *(["ahead", "correct", "seen"] if design.settles else [])]
    turns = {f"{prefix}_move": noises, f"{prefix}_factor": design.states + noises}
    return row_cost(source, [f"{prefix}_take"], turns=turns, never=[f"{prefix}_{name}" for name in seldom])


def _bytes(design: Design, number: NumberType, inner: NumberType) -> int:
    """Return the size of the state, as a compiler lays it out."""
    n, stuck, gated = design.states, bool(design.limits.stuck_readings), design.gate is not None
    size = 8 * (n * (n + 1) // 2) + 16 * gated + inner.bytes * (n + 1) + 3 * number.bytes * stuck
    size += 4 * stuck + 8 + 14 * gated + 2
    return -(-size // 8) * 8


def _table_bytes(design: Design, number: NumberType, noises: int) -> int:
    n, o = design.states, len(design.opening.weights)
    packed = n * (n + 1) // 2
    doubles = n * n + (n + 1) * noises + 2 * n + packed * (1 + design.settles) + n * (design.gate is not None)
    reals = o * n + (0 if number.is_double else n * n + 2 * n) + n * design.settles
    return 8 * doubles + number.bytes * reals
