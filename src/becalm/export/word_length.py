"""Compute the error that a word length causes in a filter with a steady state, before the filter runs.

A level that should change by less than half of its last digit does not change: it *stalls*. With a gain K it stalls
while |K nu| < ulp / 2, so that the error is up to ulp / (2 K). A slope then grows until the level changes, and the
level overshoots: the filter oscillates with that amplitude. Noisy readings prevent both. Rounding is then an additional
noise, which is added at every step and passes through the closed loop. Stall and rounding noise must each be at most a
tenth of sigma.
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
"""Largest error of a word length, over sigma in the steady state, or over the noise std of a reading."""

COUNTED = 1 << 23
"""Largest distance of a level from 0, in quanta, which float represents exactly."""

_DOUBLINGS = 60  # number of doublings of the terms in a sum
_AWAY = 64.0  # least bound on the level to which a signal returns, in standard deviations of a reading's noise


class WordLength(NamedTuple):
    """The error of a word length.

    Attributes
    ----------
    stall : float
        Largest error, in unit, at which a filter stalls on a constant signal, or amplitude of its oscillation.
    noise : float
        Standard deviation of the rounding noise, in unit.
    share : float
        The larger of `stall` and `noise`, over sigma in the steady state.
    range : float
        Largest difference of readings, in unit, for which these errors are computed. With a quantum, readings farther
        than this from 0 are overrange.
    quantum : float or None
        Step by which the level moves, in unit; None for a level that stays at the first reading.
    """

    stall: float
    noise: float
    share: float
    range: float
    quantum: float | None


def stall_of(design: Design, number: NumberType, farthest: float) -> float:
    """Return the largest error, in unit, at which a filter stalls on a constant signal, or by which it oscillates.

    Parameters
    ----------
    design : Design
        A filter with a steady state.
    number : NumberType
        Number type of the C code.
    farthest : float
        Largest magnitude of the first state, in unit.
    """
    assert design.steady is not None
    gain = abs(float((design.model.F @ design.steady.gain)[0, 0]))
    return ulp(number, farthest) / (2 * gain) if gain > 0 else np.inf


def refuse_coarse(design: Design, number: NumberType, span: tuple[float, float]) -> None:
    """Raise a RecipeError if the resolution of a number type is too coarse for the noise of readings.

    Parameters
    ----------
    design : Design
        The filter.
    number : NumberType
        Number type of the C code.
    span : (float, float)
        Least and greatest reading, in unit.

    Raises
    ------
    RecipeError
        If rounding the greatest reading adds an error of more than a tenth of the noise's standard deviation.
    """
    greatest = max(map(abs, span))
    digit, unit = ulp(number, greatest), design.unit_after
    if digit / np.sqrt(12) > MOST_ERROR * design.noise_std:
        raise RecipeError(
            f"{design.name}: {number.name} resolves readings of {greatest:.6g}{unit} only to {digit:.3g}{unit}, and"
            f" their noise is {design.noise_std:.3g}{unit}; subtract an offset first, or use --precision float64."
        )


def ulp(number: NumberType, magnitude: float) -> float:
    """Return the unit in the last place: the distance of two neighbouring numbers of a type at a magnitude."""
    return float(2.0 ** (np.floor(np.log2(max(magnitude, 1e-300))) - (number.bits - 1)))


def noise_of(design: Design, number: NumberType, farthest: float) -> float:
    """Return the standard deviation of the rounding noise in the signal, in the steady state, in unit.

    Each term of a state's sum is rounded to the last digit of the state, with a uniformly distributed error. The
    largest magnitudes of the states are in proportion to their prior standard deviations; that of the first state is
    `farthest`. The largest magnitude of a level to which the signal returns is `farthest`, or 64 standard deviations of
    a reading's noise if that is more.

    Parameters
    ----------
    design : Design
        A filter with a steady state.
    number : NumberType
        Number type of the C code.
    farthest : float
        Largest magnitude of the first state, in unit.
    """
    assert design.steady is not None
    loop, row, scale = design.steady.loop, design.steady.row, spread_of(design.steady)
    magnitudes = farthest * scale / scale[0] if scale[0] > 0 else np.full(len(scale), farthest)
    magnitudes[np.flatnonzero(design.level_direction)[1:]] = max(_AWAY * design.noise_std, farthest)
    terms = 1 + np.count_nonzero(design.model.F, axis=1)
    injected = terms * (2.0 ** (1 - number.bits) * magnitudes) ** 2 / 12
    scaled = np.divide(injected, scale**2, out=np.zeros_like(injected), where=scale > 0)
    covariance = lyapunov_sum(loop.A, np.diag(scaled))
    return float(np.sqrt((row @ covariance @ row.T)[0, 0]))


def start_error(design: Design, number: NumberType) -> float:
    """Return approximately the rounding error of the first signals, in unit.

    If the first readings hardly separate tones from a motion, large states cancel each other in the signal. Their last
    digit is then an error of the next innovation, and the gain, which may be as large as a hundred, adds it to all
    states.

    Parameters
    ----------
    design : Design
        The filter.
    number : NumberType
        Number type of the states in C.
    """
    P = design.opening.P
    gain = float(np.abs(gain_before(covariance_ahead(P, design.model), design.model)).max())
    return float(2.0**-number.bits * np.sqrt(np.diag(P).max()) * max(1.0, gain))


def lyapunov_sum(A: Floats, B: Floats) -> Floats:
    """Return the sum of A^k B A'^k over k = 0, 1, 2, ..., by doubling the number of terms."""
    total = B
    for _ in range(_DOUBLINGS):
        total, A = total + A @ total @ A.T, A @ A
    return total
