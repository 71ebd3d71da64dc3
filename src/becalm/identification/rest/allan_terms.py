"""White noise, bias instability and random walk from an Allan deviation, each with its standard error.

With m readings in a cluster, in steps T = 1, the Allan variance of the four terms is

    3 Q^2 / m^2,   N^2 / m,   (2 ln 2 / pi) B^2,   K^2 (m / 3 + 1 / (6 m))

and weighted least squares find Q^2, N^2, B^2, K^2, none negative. The last is that of a random walk
read at its instants, as the bias state of a filter is; averaged over each step it would be K^2 m / 3.
Standard errors count that the variances at two cluster times come from the same record (`allan_covariance`).
Source: IEEE Std 952-1997, annex C.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats
from becalm.errors import RecordingError, UsageError
from becalm.identification.rest.allan import AllanCurve
from becalm.identification.rest.allan_covariance import shapes, spreads
from becalm.identification.rest.datasheet import noise_variance

FEWEST_CLUSTER_TIMES = 6

_EARNED = 9.0  # by each term, in twice the log-likelihood: what three standard errors earn
_FORM = 0.02  # of the variance: how well four straight lines can describe any sensor
_ONE_SIDED_95 = 1.645
_ROUNDS = 20

_UNTOLD = (
    "No quantisation shows at the shortest cluster times.",
    "White noise is nowhere loud enough to be seen. Sample faster.",
    "The Allan deviation has no flat stretch that the other terms leave unexplained: bias instability is not told.",
    "The Allan deviation does not rise up to the longest cluster time, {longest:.3g} s: the random walk is not told. "
    "A smaller one needs a longer record.",
)


@dataclass(frozen=True)
class NoiseTerm:
    """One coefficient, or why it is not told.

    Attributes
    ----------
    value : float
        NaN if this record cannot tell it.
    standard_error : float
        Of the value, in its unit; NaN with it. It counts the terms that were found as the only ones.
    limit : float
        What the coefficient does not exceed, at 95 % one-sided by the normal approximation; told in either
        case. Of simulated records it held in 88 to 100 %.
    reason : str
        Why there is no value, in a sentence; "" where there is one.
    """

    value: float
    standard_error: float
    limit: float
    reason: str = ""


@dataclass(frozen=True)
class NoiseTerms:
    """What makes the noise of a sensor at rest; every density is two-sided.

    Attributes
    ----------
    quantisation : NoiseTerm
        Q, in unit s: the noise of each sum theta, as of a gyroscope that counts angles. The rounding
        of a rate is white, and part of `white`.
    white : NoiseTerm
        N, in unit s^(1/2): angle or velocity random walk; sigma = N / sqrt(tau).
    bias_instability : NoiseTerm
        B, in the unit: the flat stretch is 0.664 B.
    random_walk : NoiseTerm
        K, in unit / s^(1/2): rate random walk; sigma = K sqrt(tau / 3).
    misfit : float
        Root mean square of what the fit leaves, in its own standard deviations: about 1 where the
        four terms describe the sensor. Over 2, something else does: vibration, drift of the
        temperature, a filter within the sensor.
    step_s : float
        T, in seconds.
    """

    quantisation: NoiseTerm
    white: NoiseTerm
    bias_instability: NoiseTerm
    random_walk: NoiseTerm
    misfit: float
    step_s: float

    def deviation(self, cluster_times_s: ArrayLike) -> Floats:
        """Return the Allan deviation of the terms found, in the unit, at cluster times in seconds."""
        sizes = np.asarray(cluster_times_s, dtype=np.float64) / self.step_s
        found = (self.quantisation, self.white, self.bias_instability, self.random_walk)
        squares = np.nan_to_num([term.value for term in found]) ** 2 / _units(self.step_s)
        result: Floats = np.sqrt(shapes(sizes) @ squares)
        return result

    def to_noise_variance(self, rate_hz: float) -> float:
        """Return R = N^2 rate, in unit^2: the variance of one reading's white noise at `rate_hz` readings a second.

        Raises
        ------
        UsageError
            If the record does not tell white noise, or the rate is not positive.

        Notes
        -----
        At another rate than the record's it holds for a sensor that averages between two readings.
        """
        return noise_variance(_value(self.white), rate_hz)

    def to_random_walk_density(self) -> float:
        """Return q = K^2, in unit^2/s: the two-sided density of the noise that drives a wandering bias.

        It is the `noise_density` of `components.level` and of `components.motion(1, q)`; over a step it adds q T.

        Raises
        ------
        UsageError
            If the record does not tell a random walk.

        Notes
        -----
        Bias instability has no finite model and is not in q. Where B is told and K is not, q = 0 would trust
        the bias for ever; (K's `limit`)^2 is the largest q that this record allows.
        """
        return _value(self.random_walk) ** 2


def noise_terms(curve: AllanCurve) -> NoiseTerms:
    """Fit the four terms to an Allan deviation.

    Parameters
    ----------
    curve : AllanCurve
        At six cluster times or more; octaves are best. Where a filter within the sensor bends the
        curve, give `allan_deviation` only cluster times longer than that filter.

    Raises
    ------
    RecordingError
        If there are fewer cluster times, or the readings never change.

    Notes
    -----
    Weights are those of the fitted variances, so that chance lows do not pull; 2 % of each variance is
    allowed for what no straight line describes. Every choice of terms is fitted; the likeliest is taken, where
    each term must raise twice the log-likelihood by 9, as one that is three standard errors above zero does.
    A drift in one direction is read as random walk: take it out of the readings beforehand, or leave it
    there, if the filter is to follow it.
    """
    if len(curve.deviation) < FEWEST_CLUSTER_TIMES:
        raise RecordingError(
            f"{len(curve.deviation)} cluster times came; {FEWEST_CLUSTER_TIMES} are needed to tell kinds of noise "
            f"apart: give 64 readings or more in a row."
        )
    if not np.all(curve.deviation > 0):
        raise RecordingError("The readings do not change over some cluster time; a sensor without noise has no terms.")
    fit = _Fit(curve)
    subsets = [list(kept) for count in range(1, 5) for kept in combinations(range(4), count)]
    squares = min((fit.solve(kept) for kept in subsets), key=fit.cost)
    kept = np.flatnonzero(squares).tolist()
    errors = np.full(4, np.nan)
    errors[kept] = fit.errors(squares, kept)
    units = _units(curve.step_s) * curve.deviation[0] ** 2
    quantisation, white, bias_instability, random_walk = (
        _found(squares[k] * units[k], errors[k] * units[k])
        if k in kept
        else _untold(k, fit.limit(squares, kept, k) * units[k], float(curve.cluster_times_s[-1]))
        for k in range(4)
    )
    return NoiseTerms(quantisation, white, bias_instability, random_walk, fit.misfit(squares), curve.step_s)


class _Fit:
    """Weighted least squares of an Allan variance, in steps and in units of its first value."""

    def __init__(self, curve: AllanCurve) -> None:
        self.variance = (curve.deviation / curve.deviation[0]) ** 2
        self.shapes = shapes(curve.cluster_sizes)
        self.spreads = spreads(tuple(curve.cluster_sizes.tolist()), tuple(curve.counts.tolist()))

    def covariance(self, squares: Floats) -> Floats:
        """Return the covariance (k, k) of the variances, if `squares` are true."""
        spread: Floats = self.spreads @ squares @ squares
        return spread + np.diag((_FORM * self.shapes @ squares) ** 2)

    def solve(self, kept: list[int]) -> Floats:
        """Return the squares (4,) that fit, of the kept terms; 0 for the others."""
        from scipy.optimize import nnls

        squares, sigma = np.zeros(4), self.variance
        for _ in range(_ROUNDS):
            before = squares.copy()
            columns = self.shapes[:, kept] / sigma[:, np.newaxis]
            size = np.linalg.norm(columns, axis=0)
            squares[kept] = nnls(columns / size, self.variance / sigma)[0] / size
            sigma = np.sqrt(np.diag(self.covariance(squares)))
            if np.allclose(squares, before, rtol=1e-9, atol=0):
                break
        return squares

    def cost(self, squares: Floats) -> float:
        """Return minus twice the Gaussian log-likelihood of the variances, and what each term must earn."""
        root = np.linalg.cholesky(self.covariance(squares))
        left = np.linalg.solve(root, self.variance - self.shapes @ squares)
        return float(left @ left + 2 * np.log(np.diag(root)).sum() + _EARNED * np.count_nonzero(squares))

    def errors(self, squares: Floats, columns: list[int]) -> Floats:
        """Return the standard errors of some terms, estimated together, if `squares` are true."""
        covariance = self.covariance(squares)
        sigma = np.sqrt(np.diag(covariance))[:, np.newaxis]
        weigh = np.linalg.pinv(self.shapes[:, columns] / sigma, rcond=1e-12) / sigma.T
        result: Floats = np.sqrt(np.diag(weigh @ covariance @ weigh.T))
        return result

    def limit(self, squares: Floats, kept: list[int], term: int) -> float:
        """Return what the square of a term taken out does not exceed, at 95 %, were it fitted with the others."""
        columns = [*kept, term]
        sigma = np.sqrt(np.diag(self.covariance(squares)))
        weighted = self.shapes[:, columns] / sigma[:, np.newaxis]
        estimate = float((np.linalg.pinv(weighted, rcond=1e-12) @ (self.variance / sigma))[-1])
        return max(estimate, 0.0) + _ONE_SIDED_95 * float(self.errors(squares, columns)[-1])

    def misfit(self, squares: Floats) -> float:
        """Return the root mean square of what is left, in standard deviations."""
        left = (self.variance - self.shapes @ squares) / np.sqrt(np.diag(self.covariance(squares)))
        return float(np.sqrt(np.mean(left**2)))


def _units(step_s: float) -> Floats:
    """Return what turns Q^2, N^2, B^2, K^2 in steps into seconds, (4,)."""
    return np.array([step_s**2, step_s, 1.0, 1.0 / step_s])


def _found(square: float, error: float) -> NoiseTerm:
    """Return a coefficient from its square, and the error of that."""
    value = float(np.sqrt(square))
    relative = float(error / (2 * square))
    return NoiseTerm(value, relative * value, value * float(np.exp(_ONE_SIDED_95 * relative)))


def _untold(term: int, square: float, longest: float) -> NoiseTerm:
    """Return what bounds a coefficient that was not found."""
    limit = float(np.sqrt(square))
    return NoiseTerm(np.nan, np.nan, limit, _UNTOLD[term].format(longest=longest))


def _value(term: NoiseTerm) -> float:
    """Return the value of a term, or say why there is none."""
    if np.isnan(term.value):
        raise UsageError(f"{term.reason} Its `limit` may be used in its place.")
    return term.value
