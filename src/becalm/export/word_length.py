"""Compute the error that a word length causes in a filter with a steady state, before anything runs.

A level that should move by less than half of its last digit does not move: it *stalls*. With a gain K it stalls while
|K nu| < ulp / 2: the error is up to ulp / (2 K). A slope then grows until the level moves, and the level overshoots:
the filter oscillates with that amplitude. With a reading's noise neither happens; rounding is then an additional noise,
which enters at every step and passes through the closed loop. Neither error may exceed a tenth of sigma.
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
"""Largest error of a word length, as a share of sigma in the steady state, or of a reading's noise."""

COUNTED = 1 << 23
"""Largest distance of a level from 0, in quanta; float can count them exactly."""

_DOUBLINGS = 60  # of the number of terms in a sum
_AWAY = 64.0  # least bound on a level that the signal returns to, in standard deviations of a reading's noise


class WordLength(NamedTuple):
    """The error of a word length.

    Attributes
    ----------
    stall : float
        Largest error at which a filter stalls on a constant signal, or amplitude of its oscillation, in unit.
    noise : float
        Standard deviation of the rounding noise, in unit.
    share : float
        The larger of the two, relative to sigma in the steady state.
    range : float
        Largest distance of readings from each other, in unit, for which these errors are computed. With a quantum,
        readings farther than this from 0 are overrange.
    quantum : float or None
        Step by which the level moves, in unit; None where it stays at the first reading.
    """

    stall: float
    noise: float
    share: float
    range: float
    quantum: float | None


def stall_of(design: Design, number: NumberType, farthest: float) -> float:
    """Return the error at which a filter stalls on a constant signal, or about which it oscillates, in unit.

    Parameters
    ----------
    design : Design
        A filter with a steady state.
    number : NumberType
        Number type of the C code.
    farthest : float
        Largest magnitude of its first state, in unit.
    """
    assert design.steady is not None
    gain = abs(float((design.model.F @ design.steady.gain)[0, 0]))
    return ulp(number, farthest) / (2 * gain) if gain > 0 else np.inf


def refuse_coarse(design: Design, number: NumberType, span: tuple[float, float]) -> None:
    """Raise a RecipeError for a number type that resolves readings more coarsely than their noise.

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
    """Return the distance of two neighbouring numbers of this type at a magnitude."""
    return float(2.0 ** (np.floor(np.log2(max(magnitude, 1e-300))) - (number.bits - 1)))


def noise_of(design: Design, number: NumberType, farthest: float) -> float:
    """Return the standard deviation of the rounding noise in the signal, in the steady state, in unit.

    Each term of a state's sum is rounded to the last digit of the state, with a uniform error. The largest magnitudes
    of the other states are to `farthest` as their standard deviations are to that of the first. That of a level that
    the signal returns to is `farthest`, or 64 standard deviations of a reading's noise if that is more.

    Parameters
    ----------
    design : Design
        A filter with a steady state.
    number : NumberType
        Number type of the C code.
    farthest : float
        Largest magnitude of its first state, in unit.
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
    """Return about how large the rounding error of the first signals after the opening is, in unit.

    Where the first readings hardly separate tones from a motion, states are far larger than any reading, and cancel.
    Their last digit enters the next innovation, and the gain, which may be a hundred, passes it to all states.

    Parameters
    ----------
    design : Design
        The filter.
    number : NumberType
        Number type of its states in C.
    """
    P = design.opening.P
    gain = float(np.abs(gain_before(covariance_ahead(P, design.model), design.model)).max())
    return float(2.0**-number.bits * np.sqrt(np.diag(P).max()) * max(1.0, gain))


def gathered(A: Floats, B: Floats) -> Floats:
    """Return the sum of A^k B A'^k over k = 0, 1, 2, ..., by doubling the number of terms."""
    total = B
    for _ in range(_DOUBLINGS):
        total, A = total + A @ total @ A.T, A @ A
    return total
