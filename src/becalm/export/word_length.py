"""What a word length costs a filter that settles: what rounding leaves, computed before anything runs.

A level that should move by less than half of its last digit does not move: it *stalls*. With a gain K it stands still
while |K nu| < ulp / 2, an error of ulp / (2 K). A slope beside it then grows until the level moves at last, and beyond:
the filter swings as far to both sides. Under a reading's noise it does neither; rounding then is noise as well, which
enters at every step and leaves through the closed loop. Both are held against a tenth of the filter's uncertainty.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.covariances import covariance_ahead, gain_before
from becalm.errors import RecipeError
from becalm.export.design import Design, spread_of
from becalm.export.number_type import NumberType

MOST_ERROR = 0.1
"""Of a standard deviation, the signal's or a reading's: what a word length may cost."""

COUNTED = 1 << 23
"""Quanta that a level of float may count: each of them is exact."""

_DOUBLINGS = 60
_AWAY = 64.0  # standard deviations of a reading's noise, that a signal may be away from the level that it returns to


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
        Readings may lie so far from each other, and from 0, in unit; beyond, they are overrange.
    quantum : float or None
        By which the level moves, in unit; None where it stays at the first reading.
    """

    stall: float
    noise: float
    share: float
    range: float
    quantum: float | None


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


def refuse_coarse(design: Design, number: NumberType, span: tuple[float, float]) -> None:
    """Refuse a type of number that tells readings themselves more coarsely than their noise.

    Parameters
    ----------
    design : Design
        A filter.
    number : NumberType
        Of C.
    span : (float, float)
        Least and greatest reading, in unit.

    Raises
    ------
    RecipeError
        If rounding the greatest to its last digit costs more than a tenth of the noise.
    """
    greatest = max(map(abs, span))
    digit, unit = ulp(number, greatest), design.unit_after
    if digit / np.sqrt(12) > MOST_ERROR * design.noise_std:
        raise RecipeError(
            f"{design.name}: {number.name} tells readings of {greatest:.6g}{unit} to {digit:.3g}{unit} only, and their"
            f" noise is {design.noise_std:.3g}{unit}; take an offset off them before, or use --precision float64."
        )


def ulp(number: NumberType, magnitude: float) -> float:
    """Return the distance to the next number of this type."""
    return float(2.0 ** (np.floor(np.log2(max(magnitude, 1e-300))) - (number.bits - 1)))


def noise_of(design: Design, number: NumberType, farthest: float) -> float:
    """Return the standard deviation of what rounding adds to a settled signal, in unit.

    Each term of a state's sum is rounded to a last digit of the state, evenly; what a state is at the most follows from
    a first one that is `farthest`, in parts of their own uncertainties. A level that the signal returns to is as far
    from it as signals go. Beside it stands the signal's own last digit.

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
    loop, row, scale = design.steady.loop, design.steady.row, spread_of(design.steady)
    reach = farthest * scale / scale[0] if scale[0] > 0 else np.full(len(scale), farthest)
    reach[np.flatnonzero(design.level_direction)[1:]] = max(_AWAY * design.noise_std, farthest)
    terms = 1 + np.count_nonzero(design.model.F, axis=1)
    injected = terms * (2.0 ** (1 - number.bits) * reach) ** 2 / 12
    scaled = np.divide(injected, scale**2, out=np.zeros_like(injected), where=scale > 0)
    through = gathered(loop.A, np.diag(scaled))
    return float(np.sqrt((row @ through @ row.T)[0, 0]))


def start_of(design: Design, number: NumberType) -> float:
    """Return what rounding leaves of the first signals after the opening, in unit.

    Tones that the first readings hardly tell from a motion are states far beyond any reading, which cancel: their last
    digit enters the next innovation, and its gain, which may be a hundred, takes it to all states.

    Parameters
    ----------
    design : Design
        A filter.
    number : NumberType
        Of its states in C.
    """
    P = design.opening.P
    gain = float(np.abs(gain_before(covariance_ahead(P, design.model), design.model)).max())
    return float(2.0**-number.bits * np.sqrt(np.diag(P).max()) * max(1.0, gain))


def gathered(A: Floats, B: Floats) -> Floats:
    """Return the sum of A^k B A'^k over all k, by doubling."""
    total = B
    for _ in range(_DOUBLINGS):
        total, A = total + A @ total @ A.T, A @ A
    return total
