"""Whether a word is long enough for a settled filter: what rounding leaves, computed before anything runs.

A level that should move by less than half of its last digit does not move: it *stalls*. With a gain K it stands still
while |K nu| < ulp / 2, an error of ulp / (2 K). A slope beside it then grows until the level moves at last, and beyond:
the filter swings as far to both sides. Under a reading's noise it does neither; rounding then is noise as well, which
enters at every step and leaves through the closed loop. Both are held against a tenth of the filter's uncertainty.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.steady_filter import SteadyFilter
from becalm.errors import RecipeError
from becalm.export.design import Design
from becalm.export.number_type import NumberType

MOST_ERROR = 0.1
"""Of the signal's standard deviation: what a word length may cost."""

_QUANTA = tuple(2.0**k for k in range(6, -2, -1))  # of a reading's noise: a large one moves the level seldom
_UNSEEN, _STANDS = 1e-6, 1e-2  # of a reading's noise, and of the signal's: what is allowed where it can be had
_COUNTED = 1 << 23  # quanta that a level of float may count, and readings may lie off
_DOUBLINGS = 60


class WordLength(NamedTuple):
    """What a word length costs.

    Attributes
    ----------
    stall : float
        Greatest error at which a filter of a constant stands still, or about which it swings, in unit.
    noise : float
        Standard deviation of what rounding adds, in unit.
    share : float
        The larger of the two, in parts of the signal's own standard deviation.
    range : float
        Readings may lie so far from each other, in unit; beyond, they are overrange.
    quantum : float or None
        By which the level moves, in unit; None where it stays at the first reading.
    """

    stall: float
    noise: float
    share: float
    range: float
    quantum: float | None


def prove(design: Design, number: NumberType, span: float | None) -> WordLength:
    """Find what a word length costs, and whether the level has to move so that it costs little.

    Parameters
    ----------
    design : Design
        A filter that settles.
    number : NumberType
        Of C.
    span : float or None
        How far readings lie from each other at the most, in unit; None where nobody said.

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
            f" {design.settled_std:.3g} {design.unit} ({_why(found, design.unit)}), and a tenth is the most; use"
            f" {'' if number.is_double else '--precision float64, or '}a larger process_noise_density."
        )
    return found


def _moving(design: Design, number: NumberType, span: float) -> WordLength:
    """Return what a word length costs where the level moves, by a quantum as large as may be."""
    noise, least = 2.0 ** np.floor(np.log2(design.noise_std)), span / _COUNTED
    least = 2.0 ** np.ceil(np.log2(least)) if least > 0 else 0.0
    for quanta in _QUANTA:
        quantum = max(float(quanta * noise), least)
        found = _cost(design, number, quantum, quantum * _COUNTED)
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
    return f"it stalls {found.stall:.2g} {unit} off, and rounding adds {found.noise:.2g} {unit}"


def _cost(design: Design, number: NumberType, quantum: float | None, span: float) -> WordLength:
    """Return what a word length costs where the first state stays within a quantum, or within the range."""
    assert design.steady is not None
    stall = stall_of(design, number, quantum or span)
    noise = noise_of(design.steady, number, quantum or span)
    return WordLength(stall, noise, max(stall, noise) / design.settled_std, span, quantum)


def stall_of(design: Design, number: NumberType, farthest: float) -> float:
    """Return the error at which a filter of a constant stands still, or about which it swings, in unit.

    Parameters
    ----------
    design : Design
        A filter that settles.
    number : NumberType
        Of C.
    farthest : float
        Magnitude of its first state, in unit.
    """
    assert design.steady is not None
    gain = abs(float((design.model.F @ design.steady.gain)[0, 0]))
    return ulp(number, farthest) / (2 * gain) if gain > 0 else np.inf


def ulp(number: NumberType, magnitude: float) -> float:
    """Return the distance to the next number of this type."""
    return float(2.0 ** (np.floor(np.log2(max(magnitude, 1e-300))) - (number.bits - 1)))


def noise_of(steady: SteadyFilter, number: NumberType, farthest: float) -> float:
    """Return the standard deviation of what rounding adds to a settled signal, in unit.

    Each term of a state's sum is rounded to a last digit of the state, evenly; what a state is at the most follows from
    a first one that is `farthest`, in parts of their own uncertainties. Beside it stands the signal's own last digit.
    """
    loop, scale = steady.loop, np.sqrt(np.maximum(np.diag(steady.predicted_cov), 0.0))
    reach = farthest * scale / scale[0] if scale[0] > 0 else np.full(len(scale), farthest)
    terms = 1 + np.count_nonzero(steady.model.F, axis=1)
    injected = terms * (2.0 ** (1 - number.bits) * reach) ** 2 / 12
    scaled = np.divide(injected, scale**2, out=np.zeros_like(injected), where=scale > 0)
    through = gathered(loop.A, np.diag(scaled))
    return float(np.sqrt((steady.row @ through @ steady.row.T)[0, 0]))


def gathered(A: Floats, B: Floats) -> Floats:
    """Return the sum of A^k B A'^k over all k, by doubling."""
    total = B
    for _ in range(_DOUBLINGS):
        total, A = total + A @ total @ A.T, A @ A
    return total
