"""Identify the noise of a sensor at rest, and decide whether it is white or coloured.

Readings at rest are modelled as white noise of variance R, autoregressive noise of order p, and a drift, which is a
random walk. The fit maximises a likelihood. For stretches without holes, this is the likelihood of their sine
transform, whose ordinates are nearly independent and normal (Whittle, Ark. Mat. 2 (1953) 423). If many readings are
missing, it is the likelihood of the readings themselves, which the filter computes. The Bayesian information criterion
decides whether there is coloured noise, and of which order (Schwarz, Annals of Statistics 6 (1978) 461).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.channel import ChannelRecord, Sums
from becalm.core.model.autoregressive import ColouredNoise, autoregressive, from_partial_autocorrelations
from becalm.core.model.components import motion
from becalm.core.model.parts import Component
from becalm.errors import RecordingError
from becalm.identification.spectrum import pooled, sine_spectrum

# Compute the likelihood of readings with coloured noise, from their spectrum or by a filter.
#
# The prior of the motion is flat. The prior of the coloured noise is its stationary distribution, with mean 0. With a
# flat prior for both, the filter would use many readings only to separate the noise from the motion. Their number would
# depend on the coefficients, so that the likelihoods of different coefficients could not be compared.

HIGHEST_ORDER = 3
"""Highest order of coloured noise that is tried."""

UNSCORED = 6
"""Number of readings of each stretch that only start the filter, equal for every motion and noise model."""

_HALF_CYCLES = 8  # half cycles per stretch of the lowest frequency that is used
_BIN = 0.02  # width of a bin, as a share of its frequency

Misfit = Callable[["Shape"], tuple[float, float]]
"""Function of a `Shape`; returns minus twice its log-likelihood, up to a constant, and the likeliest common factor."""


@dataclass(frozen=True)
class Shape:
    """A noise model up to a common factor: the ratios of its variances."""

    white: float  # variance of the white noise
    drift: float  # density of the random walk, 1/step
    innovation: float = 0.0  # innovation variance of the coloured noise
    coefficients: tuple[float, ...] = ()  # of the coloured noise; empty for white noise

    @property
    def coloured(self) -> ColouredNoise:
        """Return the coloured part of the noise."""
        unit = ColouredNoise(self.coefficients, 1.0)
        return ColouredNoise(self.coefficients, self.innovation / unit.innovation_variance)


def spectral_misfit(parts: Sequence[Floats]) -> Misfit:
    """Return the misfit of a noise model to stretches without holes, (n,) each, computed from their sine transforms.

    Frequencies below four cycles per stretch are left out.
    """
    spectra = [sine_spectrum(part) for part in parts]
    slowest = [np.full(len(s.angle), np.pi * _HALF_CYCLES / len(z)) for s, z in zip(spectra, parts, strict=True)]
    kept = pooled(spectra).angle >= np.concatenate(slowest)
    angle, power, weight = (own[kept] for own in pooled(spectra))
    _, place = np.unique(np.floor(np.log(angle) / _BIN), return_inverse=True)
    total = np.bincount(place, weight)
    angle, power = np.bincount(place, weight * angle) / total, np.bincount(place, weight * power) / total
    walk, readings = 1 / (4 * np.sin(angle / 2) ** 2), float(total.sum())
    waves = np.cos(np.multiply.outer(np.arange(HIGHEST_ORDER + 1), angle))

    def misfit(shape: Shape) -> tuple[float, float]:
        model = shape.white + shape.drift * walk
        if shape.coefficients:
            model = model + shape.innovation / (_cosine_sum(shape.coefficients) @ waves[: len(shape.coefficients) + 1])
        factor = float(total @ (power / model)) / readings
        return float(total @ np.log(model)) + readings * (np.log(factor) + 1), factor

    return misfit


def exact_misfit(parts: Sequence[Floats]) -> Misfit:
    """Return the misfit of a noise model to stretches with holes (NaN), (n,) each, computed by the filter."""
    records = [_record(part) for part in parts]

    def misfit(shape: Shape) -> tuple[float, float]:
        component = motion(1, shape.drift)
        if shape.coefficients:
            component += autoregressive(shape.coefficients, float(np.sqrt(shape.coloured.variance)))
        total = Sums()
        for z, elapsed in records:
            total = total.plus(score_coloured(component, shape.white, z, elapsed) or Sums())
        squares, log_det, used = total
        if not squares > 0:
            return np.inf, 0.0
        return log_det + used * (np.log(squares / used) + 1), squares / used

    return misfit


def score_coloured(component: Component, noise_variance: float, z: Floats, elapsed: Floats) -> Sums | None:
    """Return the likelihood sums of all readings after the sixth; the coloured noise starts as stationary noise.

    Return None if the first six readings do not determine the state of the motion.

    Parameters
    ----------
    component : Component
        A motion with coloured noise, in steps.
    noise_variance : float
        R, in unit^2.
    z : (N, 1) float array
        Readings in unit, none missing.
    elapsed : (N,) float array
        Steps since the previous reading, in whole numbers.
    """
    sums = ChannelRecord(component, noise_variance, z[:, 0], elapsed).score(UNSCORED)
    return sums if sums.used == len(z) - UNSCORED else None


def start_of_first_run(elapsed: Floats) -> int:
    """Return the row at which the first run of `UNSCORED` evenly sampled readings begins; 0 if there is none."""
    even = np.convolve(elapsed[1:] == 1.0, np.ones(UNSCORED - 1), "valid") if len(elapsed) >= UNSCORED else np.zeros(0)
    whole = np.flatnonzero(even > UNSCORED - 1.5)
    return int(whole[0]) if len(whole) else 0


def _record(part: Floats) -> tuple[Floats, Floats]:
    """Return the finite readings (m, 1) and the steps (m,) between them, from the first run that starts the filter."""
    seen = np.flatnonzero(np.isfinite(part))
    elapsed = np.diff(seen, prepend=seen[0]).astype(np.float64)
    begin = start_of_first_run(elapsed)
    return np.ascontiguousarray(part[seen[begin:], np.newaxis]), elapsed[begin:]


def _cosine_sum(coefficients: tuple[float, ...]) -> Floats:
    """Return the coefficients c (p + 1,) for which |1 - sum phi_l exp(-i w l)|^2 = sum c_l cos(l w).

    `autoregressive_power` uses the same polynomial. A search evaluates the polynomial thousands of times at the same
    angles; with c, one table of cosines is enough for all of them.
    """
    a = np.array([1.0, *(-phi for phi in coefficients)])
    lagged = np.correlate(a, a, "full")[len(a) - 1 :]
    return np.append(lagged[:1], 2 * lagged[1:])


FEWEST_AT_REST = 64
"""Least number of readings at rest, both in total and in each run without holes that is used."""

LONGEST_CORRELATION = 0.1
"""Longest correlation time of coloured noise, as a share of a stretch's length; slower noise looks like a drift."""

LEAST_WHITE = 1e-3
"""Least R, as a share of the coloured noise's innovation variance."""

_PIECE, _PIECES = 2048, 2  # rows in a piece, and most pieces, where the filter computes the likelihood
_WHITES = (-12.0, 14.0)  # limits of log(R / innovation variance - LEAST_WHITE), and ...
_DRIFTS = (-30.0, 14.0)  # ... of log(drift density / (R + innovation variance))
_PARTIAL = 6.0  # limit of |artanh(kappa)|, with the partial autocorrelations kappa
_AT_LIMIT = 1.2  # decay rate of a fit, over the slowest rate allowed, below which the fit counts as at the limit
_BEGIN_PARTIAL = ((0.97, 0.8, 0.4, -0.1, -0.5, -0.9), (-0.9, -0.5, 0.3), (-0.4, 0.4))  # starting values of each kappa
_BEGIN_WHITES, _BEGIN_DRIFT = (-4.0, -1.0, 2.0), -12.0  # starting values of the two logarithms above


@dataclass(frozen=True)
class NoiseModel:
    """A model of one channel's noise at rest: white noise, coloured noise and a drift.

    Attributes
    ----------
    white_variance : float
        R, the variance of the white noise, in unit^2.
    coloured : ColouredNoise or None
        Autocorrelated noise; None where the readings do not show any.
    drift_density : float
        Density of the drift, a random walk, in unit^2/step; partly an artefact of where stretches start and end.
    count : int
        Number of readings used; if many are missing, only those in at most two pieces of 2048 rows.
    gain : float
        Reduction of the information criterion (twice a log-likelihood) by coloured noise; 0 if there is none.
    """

    white_variance: float
    coloured: ColouredNoise | None
    drift_density: float
    count: int
    gain: float = 0.0


def fit_noise(stretches: Sequence[Floats]) -> NoiseModel:
    """Identify the noise of readings at rest: the white part, the coloured part and the drift.

    Parameters
    ----------
    stretches : sequence of (n,) float array
        Evenly sampled readings of one channel, in its unit, NaN where missing. Each stretch has a level of its own.

    Raises
    ------
    RecordingError
        If there are fewer than 64 readings, or no piece of 2048 rows has 64.

    Notes
    -----
    A slow drift and noise with a long correlation time look alike: one stretch cannot distinguish a sensor's wandering
    bias from a slow motion. Therefore periods longer than a quarter of a stretch are left out, a random walk is part of
    every candidate, and the correlation of coloured noise must fall to 1/e within a tenth of a stretch. Slower noise
    counts as motion, and R contains only the white noise. Noise with a correlation time of more than about a hundredth
    of a stretch already resembles a drift and may be identified as one; that does less harm than identifying motion as
    noise. A steady tone at rest is identified as coloured noise of order 2 with a narrow resonance.

    R is never below a thousandth of the innovation variance of the coloured noise. The readings cannot distinguish so
    little white noise from none. The limit costs a filter at most a thousandth of its variance, and keeps the posterior
    covariance from being singular.
    """
    centred = [_centred(part) for part in stretches if np.isfinite(part).any()]
    count = sum(int(np.isfinite(part).sum()) for part in centred)
    if count < FEWEST_AT_REST:
        raise RecordingError(
            f"{count} readings at rest came; {FEWEST_AT_REST} are needed to identify noise. Name a longer rest."
        )
    scale = float(sum(np.nansum(part**2) for part in centred)) / count
    if not scale > 0:
        return NoiseModel(0.0, None, 0.0, count)
    whole = [run / np.sqrt(scale) for part in centred for run in _runs(part)]
    if sum(len(run) for run in whole) >= count / 2:
        return _choose_order([spectral_misfit(whole)], _largest_pole(whole), count, scale)
    pieces = [piece / np.sqrt(scale) for piece in _pieces(centred)]
    if not pieces:
        raise RecordingError(f"No stretch at rest holds {FEWEST_AT_REST} readings; name a longer rest.")
    used = sum(int(np.isfinite(piece).sum()) for piece in pieces)
    misfits = [spectral_misfit([_interpolated(piece) for piece in pieces]), exact_misfit(pieces)]
    return _choose_order(misfits, _largest_pole(pieces), used, scale)


def _choose_order(misfits: Sequence[Misfit], limit: float, count: int, scale: float) -> NoiseModel:
    """Return the noise model with the smallest information criterion, computed with the last of the misfits.

    The misfits are minimised in turn; each search starts where the previous one ended. Order 3 is tried only if order 1
    or 2 is better than white noise.
    """

    def cost(theta: Floats, misfit: Misfit = misfits[-1]) -> float:
        return misfit(_shape(theta, limit))[0]

    def fit(order: int) -> tuple[Shape, float]:
        starts = _starting_points(order)
        for misfit in misfits:
            starts = [_fit(partial(cost, misfit=misfit), starts)]
        return _shape(starts[0], limit), cost(starts[0]) + (3 + order if order else 2) * np.log(count)

    best, white = fit(0)
    least = white
    for order in range(1, HIGHEST_ORDER + 1):
        if order < HIGHEST_ORDER or best.coefficients:
            shape, criterion = fit(order)
            if criterion < least and _is_within_limit(shape.coefficients, limit):
                best, least = shape, criterion
    unit = misfits[-1](best)[1] * scale
    coloured = best.coloured._replace(variance=unit * best.coloured.variance) if best.coefficients else None
    return NoiseModel(unit * best.white, coloured, unit * best.drift, count, float(white - least))


def _starting_points(order: int) -> list[Floats]:
    """Return the starting points of the fit of one order."""
    kappas = [np.arctanh(start) for start in _BEGIN_PARTIAL[:order]]
    whites = (_BEGIN_WHITES,) if order else ()
    return [np.array(start) for start in product(*kappas, *whites, (_BEGIN_DRIFT,))]


def _fit(cost: Callable[[Floats], float], starts: Sequence[Floats]) -> Floats:
    """Minimise the cost from the best of several starting points; return theta there."""
    from scipy.optimize import minimize

    start = min(starts, key=cost)
    bounds = [(-_PARTIAL, _PARTIAL)] * (len(start) - 2) + [_WHITES] * (len(start) > 1) + [_DRIFTS]
    return np.asarray(minimize(cost, start, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-7}).x)


def _shape(theta: Floats, limit: float) -> Shape:
    """Return the noise at theta: artanh of p partial autocorrelations, then the logarithms in `_WHITES` and `_DRIFTS`.

    For white noise theta is only the last of them. Multiplying phi_i by limit^i multiplies every pole by `limit`.
    """
    if len(theta) == 1:
        return Shape(1.0, float(np.exp(theta[0])))
    kappas, white = np.tanh(theta[:-2]), LEAST_WHITE + float(np.exp(theta[-2]))
    phi = np.array(from_partial_autocorrelations(kappas.tolist()))
    phi *= limit ** np.arange(1, len(phi) + 1)
    return Shape(white, (1 + white) * float(np.exp(theta[-1])), 1.0, tuple(phi.tolist()))


def _is_within_limit(coefficients: tuple[float, ...], limit: float) -> bool:
    """Return whether the slowest pole decays clearly faster than a pole at `limit`."""
    slowest = np.abs(np.roots([1.0, *(-phi for phi in coefficients)])).max(initial=0.0)
    return bool(-np.log(max(slowest, 1e-300)) >= -_AT_LIMIT * np.log(limit))


def _centred(part: Floats) -> Floats:
    """Return a stretch (n,) less the mean of its finite readings; equal readings give exactly zero."""
    part = np.where(np.isfinite(part), part, np.nan)
    about = part - part[np.flatnonzero(np.isfinite(part))[0]]
    return np.asarray(about - np.nanmean(about))


def _runs(part: Floats) -> list[Floats]:
    """Return the runs of at least 64 readings without holes."""
    bounds = np.flatnonzero(~np.isfinite(np.concatenate([[np.nan], part, [np.nan]])))
    return [part[a : b - 1] for a, b in pairwise(bounds.tolist()) if b - a > FEWEST_AT_REST]


def _pieces(parts: Sequence[Floats]) -> list[Floats]:
    """Return a few pieces, evenly spread over all stretches."""
    pieces = [part[a : a + _PIECE] for part in parts for a in range(0, len(part), _PIECE)]
    pieces = [piece for piece in pieces if np.isfinite(piece).sum() >= FEWEST_AT_REST]
    chosen = np.linspace(0, len(pieces) - 1, min(_PIECES, len(pieces))).astype(int)
    return [pieces[k] for k in chosen]


def _largest_pole(parts: Sequence[Floats]) -> float:
    """Return the largest pole allowed, whose correlation falls to 1/e within a tenth of the median stretch."""
    return float(np.exp(-1 / (LONGEST_CORRELATION * np.median([len(part) for part in parts]))))


def _interpolated(piece: Floats) -> Floats:
    """Fill the holes of a piece (n,) by linear interpolation, which is accurate enough to start a search."""
    seen = np.flatnonzero(np.isfinite(piece))
    return np.interp(np.arange(len(piece)), seen, piece[seen])
