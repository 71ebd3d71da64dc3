"""The prior of a filter in information form, for a start from the first readings alone.

The information on a state is Y = P^-1 and y = P^-1 x; for a flat prior, Y is exactly 0. The filter adds the information
of readings until the sum determines the state (`native/opening.h`). Sources of the information form: Fraser and
Potter, IEEE TAC-14 (1969) 387; Anderson and Moore 1979, section 6.3.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Floats
from becalm.core.model.covariances import covariance_ahead
from becalm.core.model.model import Model, System
from becalm.core.reading_verdicts import BEYOND_ANY_SENSOR
from becalm.errors import ModelError

WIDE = 1e9  # largest prior variance of a reading over R: above it P - K S K' keeps less than seven digits
_INVERTIBLE = 1e14  # matrices with a smaller condition number have an inverse


class PriorInformation(NamedTuple):
    """Prior information on the state, possibly none in some directions."""

    Y: Floats  # (n, n) inverse covariance
    y: Floats  # (n,)


def arrived(readings: Floats) -> Booleans:
    """Return which readings can be used: those with a magnitude of at most `BEYOND_ANY_SENSOR`."""
    with np.errstate(invalid="ignore"):
        usable: Booleans = np.abs(readings) <= BEYOND_ANY_SENSOR
    return usable


def flat_prior(model: Model) -> PriorInformation:
    """Return `model.known`, or no information; unobservable directions get the mean 0 and unit variance."""
    Y = model.unobservable @ model.unobservable.T
    return PriorInformation(Y if model.known is None else Y + model.known, np.zeros(len(Y)))


def wide_prior(model: Model) -> PriorInformation | None:
    """Return x0 and P0 as information if P0 is so wide that covariances would lose digits; otherwise None.

    The result is also None if the process noise is nearly as wide, or if P0, F or R has no inverse.
    """
    if model.x0 is None or model.P0 is None:
        return None
    prior = np.diag(model.H @ model.P0 @ model.H.T)
    noise = np.zeros_like(model.P0)
    for _ in range(model.states):
        noise = covariance_ahead(noise, model)
    process = np.diag(model.H @ noise @ model.H.T)
    if not (prior > WIDE * np.diag(model.R)).any() or (process > 0.1 * WIDE * np.diag(model.R)).any():
        return None
    if any(not np.linalg.cond(A) < _INVERTIBLE for A in (_unit_diagonal(model.P0), model.F, _unit_diagonal(model.R))):
        return None
    Y = _symmetric_inverse(model.P0)
    return PriorInformation(Y, Y @ model.x0)


def root_of(Y: Floats) -> Floats:
    """Return the upper triangular root U of a semidefinite Y = U' U; the scales of the states may differ widely."""
    scale = np.sqrt(np.diag(Y))
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh(Y / np.outer(scale, scale))
    root = np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0.0))).T, mode="r") * scale
    return np.asarray(root * np.where(np.diag(root) < 0, -1.0, 1.0)[:, np.newaxis])


def _symmetric_inverse(Y: Floats) -> Floats:
    scale = 1 / np.sqrt(np.diag(Y))
    P = np.linalg.inv(Y * np.outer(scale, scale)) * np.outer(scale, scale)
    return (P + P.T) / 2


def refuse_singular(system: System) -> None:
    """Raise a ModelError if F or R has no inverse, which a flat start needs."""
    for name, matrix in (("F", system.F[0]), ("R", _unit_diagonal(system.R))):
        if not (np.linalg.cond(matrix) < _INVERTIBLE):
            raise ModelError(
                f"{name} has no inverse, so the filter cannot start from the first readings alone. "
                "Give x0 and P0, the state expected before the first reading and its covariance."
            )


def _unit_diagonal(R: Floats) -> Floats:
    """Return the correlation matrix of a covariance; rows without variance stay zero."""
    sigma = np.sqrt(np.diag(R))
    scale = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0)
    return R * scale[:, np.newaxis] * scale
