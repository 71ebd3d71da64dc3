"""Whether a word is long enough for a settled filter, and whether its level has to move for that.

A level that stays at the first reading is exact, and leaves a state as large as readings lie apart; one that moves by
whole quanta leaves one that is at most a quantum, and is exact as long as float counts them.
"""

from __future__ import annotations

import numpy as np

from becalm.errors import RecipeError
from becalm.export.design import Design
from becalm.export.number_type import NumberType
from becalm.export.word_length import COUNTED, MOST_ERROR, WordLength, noise_of, stall_of

_QUANTA = tuple(2.0**k for k in range(6, -2, -1))  # of a reading's noise: a large one moves the level seldom
_UNSEEN, _STANDS = 1e-6, 1e-2  # of a reading's noise, and of the signal's: what is allowed where it can be had


def prove(design: Design, number: NumberType, span: float | None) -> WordLength:
    """Find what a word length costs, and whether the level has to move so that it costs little.

    Parameters
    ----------
    design : Design
        A filter that settles.
    number : NumberType
        Of C.
    span : float or None
        How far readings lie from each other at the most, in unit; a *small* one leaves more digits, and trusts that
        they never lie farther apart: beyond, they are overrange. None where nobody said.

    Raises
    ------
    RecipeError
        If the error exceeds a tenth of the signal's standard deviation whatever is done.
    """
    assert design.steady is not None, "a filter that never settles carries a covariance"
    if span is None and number.is_double:
        return _cost(design, number, None, _widest(design, number))
    if span is not None:
        fixed = _cost(design, number, None, span)
        if _is_unseen(design, fixed) or (number.is_double and fixed.share <= MOST_ERROR):
            return fixed
    found = _moving(design, number, span or 0.0)
    if not found.share <= MOST_ERROR:
        raise RecipeError(
            f"{design.name}: {number.name} would cost {found.share:.2g} of the signal's standard deviation of"
            f" {design.settled_std:.3g}{design.unit_after} ({_why(found, design.unit_after)}), and a tenth is the"
            f" most; use {'' if number.is_double else '--precision float64, or '}a larger process_noise_density."
        )
    return found


def _moving(design: Design, number: NumberType, span: float) -> WordLength:
    """Return what a word length costs where the level moves, by a quantum as large as may be."""
    noise, least = 2.0 ** np.floor(np.log2(design.noise_std)), span / COUNTED
    least = 2.0 ** np.ceil(np.log2(least)) if least > 0 else 0.0
    for quanta in _QUANTA:
        quantum = max(float(quanta * noise), least)
        found = _cost(design, number, quantum, quantum * COUNTED)
        if _is_unseen(design, found):
            break
    return found


def _is_unseen(design: Design, found: WordLength) -> bool:
    """Whether a word length costs next to nothing."""
    return found.noise <= _UNSEEN * design.noise_std and found.stall <= _STANDS * design.settled_std


def _widest(design: Design, number: NumberType) -> float:
    """Return how far readings may lie apart where the level stays at the first of them."""
    one = _cost(design, number, None, 1.0)
    return min(design.largest, number.greatest, MOST_ERROR / one.share)


def _why(found: WordLength, unit: str) -> str:
    """Say what is lost; `unit` comes after a number."""
    return f"it stalls {found.stall:.2g}{unit} off, and rounding adds {found.noise:.2g}{unit}"


def _cost(design: Design, number: NumberType, quantum: float | None, span: float) -> WordLength:
    """Return what a word length costs where the first state stays within a quantum, or within the range."""
    stall = stall_of(design, number, quantum or span)
    noise = noise_of(design, number, quantum or span)
    return WordLength(stall, noise, max(stall, noise) / design.settled_std, span, quantum)
