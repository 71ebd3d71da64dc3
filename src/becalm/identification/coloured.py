"""The noise of a sensor at rest, white or coloured, and which of both it is.

The spectrum of readings at rest is white noise of variance R, autoregressive noise of order p beside
it, and a drift: a random walk, of which nothing is kept. It is fitted by likelihood: of the sine
transform of stretches without holes, whose ordinates are nearly independent and normal (Whittle, Ark.
Mat. 2 (1953) 423); or of the readings themselves, by the filter, where many are missing. Whether there is
coloured noise, and of which order, is decided by the Bayesian information criterion (Schwarz, Annals
of Statistics 6 (1978) 461).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.autoregressive import ColouredNoise, from_partial_autocorrelations
from becalm.errors import RecordingError
from becalm.identification.coloured_likelihood import HIGHEST_ORDER, Misfit, Shape, exact_misfit, spectral_misfit

FEWEST_AT_REST = 64
"""Readings without a hole that are a stretch, or readings in all."""

FORGETS = 0.1
"""Of a stretch's length: noise that remembers longer is not told from a drift."""

LEAST_WHITE = 1e-3
"""Of the coloured noise's innovation variance, that R has at least."""

_PIECE, _PIECES = 2048, 2  # rows, where the filter itself must be run
_WHITES = (-12.0, 14.0)  # limits of log(R / innovation variance), above the least, and ...
_DRIFTS = (-30.0, 14.0)  # ... of log(drift density / variance of the fastest noise)
_PARTIAL = 6.0  # limit of artanh(kappa)
_AT_LIMIT = 1.2  # times the slowest decay allowed: noise at the limit of what it may remember
_BEGIN_PARTIAL = ((0.97, 0.8, 0.4, -0.1, -0.5, -0.9), (-0.9, -0.5, 0.3), (-0.4, 0.4))
_BEGIN_WHITES, _BEGIN_DRIFT = (-4.0, -1.0, 2.0), -12.0


@dataclass(frozen=True)
class NoiseModel:
    """The noise of one channel at rest.

    Attributes
    ----------
    white_variance : float
        R, in unit^2, of the noise that no reading shares with another.
    coloured : ColouredNoise or None
        Noise beside it that remembers; None where readings do not tell any.
    drift_density : float
        Of the random walk beneath, in unit^2/step: in part an artefact of where stretches begin and end.
    count : int
        Readings that it was told from: of more than 4096 with many missing, two pieces of 2048 rows.
    gain : float
        By how much the criterion (twice a log-likelihood) prefers this to white noise alone; 0 for white noise.
    """

    white_variance: float
    coloured: ColouredNoise | None
    drift_density: float
    count: int
    gain: float = 0.0


def fit_noise(stretches: Sequence[Floats]) -> NoiseModel:
    """Tell the noise of readings at rest: how much of it is white, and whether the rest remembers.

    Parameters
    ----------
    stretches : sequence of (n,) float array
        Readings of one channel in even time, in its unit, NaN where missing. Each stretch is at a level of its own.

    Raises
    ------
    RecordingError
        If fewer than 64 readings came, or so many in no stretch.

    Notes
    -----
    A slow drift and noise that remembers long look alike: within a stretch nobody can tell a sensor's
    wandering bias from a slow motion. So what takes more than a quarter of a stretch is not looked at, a random
    walk is fitted beneath every candidate, and coloured noise must forget (fall to 1/e) within a
    tenth of a stretch: what remembers longer is left to the motion, and R is what is white beside it.
    What remembers longer than about a hundredth already looks much like a drift and may be called one;
    that costs less than a motion that is taken for noise.
    A steady tone at rest is taken for a narrow resonance of order 2.

    R is never below a thousandth of the innovation variance of the coloured noise: readings do not tell so
    little white noise from none, it costs a filter a thousandth of its variance at the most, and it
    keeps the covariance after each reading from being singular.
    """
    centred = [_centred(part) for part in stretches if np.isfinite(part).any()]
    count = sum(int(np.isfinite(part).sum()) for part in centred)
    if count < FEWEST_AT_REST:
        raise RecordingError(
            f"{count} readings at rest came; noise is told from {FEWEST_AT_REST} on. Name a longer rest."
        )
    scale = float(sum(np.nansum(part**2) for part in centred)) / count
    if not scale > 0:
        return NoiseModel(0.0, None, 0.0, count)
    whole = [run / np.sqrt(scale) for part in centred for run in _runs(part)]
    if sum(len(run) for run in whole) >= count / 2:
        return _chosen([spectral_misfit(whole)], _memory_limit(whole), count, scale)
    pieces = [piece / np.sqrt(scale) for piece in _pieces(centred)]
    if not pieces:
        raise RecordingError(f"No stretch at rest holds {FEWEST_AT_REST} readings; name a longer rest.")
    used = sum(int(np.isfinite(piece).sum()) for piece in pieces)
    misfits = [spectral_misfit([_bridged(piece) for piece in pieces]), exact_misfit(pieces)]
    return _chosen(misfits, _memory_limit(pieces), used, scale)


def _chosen(misfits: Sequence[Misfit], limit: float, count: int, scale: float) -> NoiseModel:
    """Return the candidate of the least information criterion by the last misfit, searched by each in turn.

    Order 3 is tried where a lower one was chosen.
    """

    def cost(theta: Floats, misfit: Misfit = misfits[-1]) -> float:
        return misfit(_shape(theta, limit))[0]

    def fit(order: int) -> tuple[Shape, float]:
        begins = _begins(order)
        for misfit in misfits:
            begins = [_fit(partial(cost, misfit=misfit), begins)]
        return _shape(begins[0], limit), cost(begins[0]) + (3 + order if order else 2) * np.log(count)

    best, white = fit(0)
    least = white
    for order in range(1, HIGHEST_ORDER + 1):
        if order < HIGHEST_ORDER or best.coefficients:
            shape, criterion = fit(order)
            if criterion < least and _forgets(shape.coefficients, limit):
                best, least = shape, criterion
    unit = misfits[-1](best)[1] * scale
    coloured = best.coloured._replace(variance=unit * best.coloured.variance) if best.coefficients else None
    return NoiseModel(unit * best.white, coloured, unit * best.drift, count, float(white - least))


def _begins(order: int) -> list[Floats]:
    """Return where a fit of one order may begin."""
    kappas = [np.arctanh(begin) for begin in _BEGIN_PARTIAL[:order]]
    whites = (_BEGIN_WHITES,) if order else ()
    return [np.array(begin) for begin in product(*kappas, *whites, (_BEGIN_DRIFT,))]


def _fit(cost: Callable[[Floats], float], begins: Sequence[Floats]) -> Floats:
    """Return the theta of the least cost, from the best of several begins."""
    from scipy.optimize import minimize

    begin = min(begins, key=cost)
    bounds = [(-_PARTIAL, _PARTIAL)] * (len(begin) - 2) + [_WHITES] * (len(begin) > 1) + [_DRIFTS]
    return np.asarray(minimize(cost, begin, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-7}).x)


def _shape(theta: Floats, limit: float) -> Shape:
    """Return the noise at theta: artanh of p partial autocorrelations, log of R beyond the least, log of the drift.

    Coefficients phi_i limit^i have the poles of phi_i, `limit` times as large.
    """
    if len(theta) == 1:
        return Shape(1.0, float(np.exp(theta[0])))
    kappas, white = np.tanh(theta[:-2]), LEAST_WHITE + float(np.exp(theta[-2]))
    phi = np.array(from_partial_autocorrelations(kappas.tolist()))
    phi *= limit ** np.arange(1, len(phi) + 1)
    return Shape(white, (1 + white) * float(np.exp(theta[-1])), 1.0, tuple(phi.tolist()))


def _forgets(coefficients: tuple[float, ...], limit: float) -> bool:
    """Whether the slowest pole lies well within the limit."""
    slowest = np.abs(np.roots([1.0, *(-phi for phi in coefficients)])).max(initial=0.0)
    return bool(-np.log(max(slowest, 1e-300)) >= -_AT_LIMIT * np.log(limit))


def _centred(part: Floats) -> Floats:
    """Take the mean off a stretch (n,), missing readings left aside, so that equal readings leave zero."""
    part = np.where(np.isfinite(part), part, np.nan)
    about = part - part[np.flatnonzero(np.isfinite(part))[0]]
    return np.asarray(about - np.nanmean(about))


def _runs(part: Floats) -> list[Floats]:
    """Return the runs of readings without a hole that are long enough to be a stretch."""
    bounds = np.flatnonzero(~np.isfinite(np.concatenate([[np.nan], part, [np.nan]])))
    return [part[a : b - 1] for a, b in pairwise(bounds.tolist()) if b - a > FEWEST_AT_REST]


def _pieces(parts: Sequence[Floats]) -> list[Floats]:
    """Return some pieces, evenly spread, of stretches that are long in all."""
    pieces = [part[a : a + _PIECE] for part in parts for a in range(0, len(part), _PIECE)]
    pieces = [piece for piece in pieces if np.isfinite(piece).sum() >= FEWEST_AT_REST]
    chosen = np.linspace(0, len(pieces) - 1, min(_PIECES, len(pieces))).astype(int)
    return [pieces[k] for k in chosen]


def _memory_limit(parts: Sequence[Floats]) -> float:
    """Return how large a pole of noise may be that forgets within some of a stretch."""
    return float(np.exp(-1 / (FORGETS * np.median([len(part) for part in parts]))))


def _bridged(piece: Floats) -> Floats:
    """Fill holes (n,) by straight lines: roughly right, for a search to begin."""
    seen = np.flatnonzero(np.isfinite(piece))
    return np.interp(np.arange(len(piece)), seen, piece[seen])
