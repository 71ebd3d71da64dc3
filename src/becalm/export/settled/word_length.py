"""Check whether a word length is enough for a steady-state filter, and whether its level has to move.

A level that stays at the first reading is exact, but the state becomes as large as the distance of readings from it.
If the level moves by whole quanta, the state is at most a quantum, and the level is exact as long as float can count
the quanta.
"""

from __future__ import annotations

import numpy as np

from becalm.errors import RecipeError
from becalm.export.design import Design
from becalm.export.number_type import NumberType
from becalm.export.word_length import COUNTED, MOST_ERROR, WordLength, noise_of, stall_of

_QUANTA = tuple(2.0**k for k in range(6, -2, -1))  # quanta to try, relative to a reading's noise
_UNSEEN_NOISE = 1e-6  # negligible rounding noise, as a share of a reading's noise
_UNSEEN_STALL = 1e-2  # negligible stall, as a share of sigma in the steady state


def prove(design: Design, number: NumberType, span: float | None) -> WordLength:
    """Compute the error of a word length; if a fixed level makes it too large, let the level move.

    Parameters
    ----------
    design : Design
        A filter with a steady state.
    number : NumberType
        Number type of the C code.
    span : float or None
        Largest distance of two readings, in unit; None if unknown. A *small* one leaves more digits, and trusts that
        readings are never farther apart.

    Raises
    ------
    RecipeError
        If the error exceeds a tenth of sigma in the steady state with a moving level too.
    """
    assert design.steady is not None, "a filter without a steady state carries a covariance"
    if span is None and number.is_double:
        return _cost(design, number, None, _widest(design, number))
    if span is not None:
        fixed = _cost(design, number, None, span)
        if _is_unseen(design, fixed) or (number.is_double and fixed.share <= MOST_ERROR):
            return fixed
    word = _moving(design, number, span or 0.0)
    if not word.share <= MOST_ERROR:
        raise RecipeError(
            f"{design.name}: with {number.name} the error is {word.share:.2g} of the signal's standard deviation of"
            f" {design.settled_std:.3g}{design.unit_after} ({_why(word, design.unit_after)}); a tenth is allowed; use"
            f" {'' if number.is_double else '--precision float64, or '}a larger process_noise_density."
        )
    return word


def _moving(design: Design, number: NumberType, span: float) -> WordLength:
    """Return the error with a moving level, for the largest quantum that makes it negligible, or else the smallest."""
    noise, least = 2.0 ** np.floor(np.log2(design.noise_std)), span / COUNTED
    least = 2.0 ** np.ceil(np.log2(least)) if least > 0 else 0.0
    for quanta in _QUANTA:
        quantum = max(float(quanta * noise), least)
        word = _cost(design, number, quantum, quantum * COUNTED)
        if _is_unseen(design, word):
            break
    return word


def _is_unseen(design: Design, word: WordLength) -> bool:
    """Return whether the error of a word length is negligible."""
    return word.noise <= _UNSEEN_NOISE * design.noise_std and word.stall <= _UNSEEN_STALL * design.settled_std


def _widest(design: Design, number: NumberType) -> float:
    """Return the largest distance of readings that a level which stays at the first one permits, in unit."""
    one = _cost(design, number, None, 1.0)
    return min(design.largest, number.greatest, MOST_ERROR / one.share)


def _why(word: WordLength, unit: str) -> str:
    """Return a description of the error; `unit` is that of `Design.unit_after`."""
    return f"it stalls {word.stall:.2g}{unit} off, and rounding adds {word.noise:.2g}{unit}"


def _cost(design: Design, number: NumberType, quantum: float | None, span: float) -> WordLength:
    """Return the error of a word length if the first state stays within a quantum; without one, within `span`."""
    stall = stall_of(design, number, quantum or span)
    noise = noise_of(design, number, quantum or span)
    return WordLength(stall, noise, max(stall, noise) / design.settled_std, span, quantum)
