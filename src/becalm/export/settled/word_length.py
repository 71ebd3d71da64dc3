"""Check whether a word length is sufficient for a steady-state filter, and whether the level has to move.

The filter subtracts a level from all readings. A level that stays at the first reading is exact, but the state becomes
as large as the distance of readings from this level. If the level moves by whole quanta, the state is at most one
quantum, and the level is exact as long as float represents the number of quanta exactly.
"""

from __future__ import annotations

import numpy as np

from becalm.errors import RecipeError
from becalm.export.design import Design
from becalm.export.number_type import NumberType
from becalm.export.word_length import COUNTED, MOST_ERROR, WordLength, noise_of, stall_of

_QUANTA = tuple(2.0**k for k in range(6, -2, -1))  # quanta to try, over the noise std of a reading
_UNSEEN_NOISE = 1e-6  # negligible rounding noise, over the noise std of a reading
_UNSEEN_STALL = 1e-2  # negligible stall, over sigma in the steady state


def choose_word_length(design: Design, number: NumberType, span: float | None) -> WordLength:
    """Compute the error of a word length with a fixed level, or with a moving level if that error is too large.

    Parameters
    ----------
    design : Design
        A filter with a steady state.
    number : NumberType
        Number type of the C code.
    span : float or None
        Largest difference of two readings, in unit; None if unknown. A *small* value leaves more digits, and trusts
        that readings never differ by more.

    Raises
    ------
    RecipeError
        If the error exceeds a tenth of sigma in the steady state even with a moving level.
    """
    assert design.steady is not None, "a filter without a steady state has a covariance"
    if span is None and number.is_double:
        return _error(design, number, None, _widest(design, number))
    if span is not None:
        fixed = _error(design, number, None, span)
        if _is_negligible(design, fixed) or (number.is_double and fixed.share <= MOST_ERROR):
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
    """Return the error with a moving level, for the largest quantum with a negligible error, or else the smallest."""
    noise, least = 2.0 ** np.floor(np.log2(design.noise_std)), span / COUNTED
    least = 2.0 ** np.ceil(np.log2(least)) if least > 0 else 0.0
    for quanta in _QUANTA:
        quantum = max(float(quanta * noise), least)
        word = _error(design, number, quantum, quantum * COUNTED)
        if _is_negligible(design, word):
            break
    return word


def _is_negligible(design: Design, word: WordLength) -> bool:
    """Return whether the error of a word length is negligible."""
    return word.noise <= _UNSEEN_NOISE * design.noise_std and word.stall <= _UNSEEN_STALL * design.settled_std


def _widest(design: Design, number: NumberType) -> float:
    """Return the largest difference of readings, in unit, that a level at the first reading permits."""
    one = _error(design, number, None, 1.0)
    return min(design.largest, number.greatest, MOST_ERROR / one.share)


def _why(word: WordLength, unit: str) -> str:
    """Return a description of the error; `unit` as in `Design.unit_after`."""
    return f"it stalls {word.stall:.2g}{unit} off, and rounding adds {word.noise:.2g}{unit}"


def _error(design: Design, number: NumberType, quantum: float | None, span: float) -> WordLength:
    """Return the error of a word length for a first state of at most one quantum, or of `span` without a quantum."""
    stall = stall_of(design, number, quantum or span)
    noise = noise_of(design, number, quantum or span)
    return WordLength(stall, noise, max(stall, noise) / design.settled_std, span, quantum)
