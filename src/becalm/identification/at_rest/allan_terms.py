"""Estimate white noise, bias instability and random walk from an Allan deviation, with standard errors.

For m readings in a cluster, with steps of T = 1, the Allan variances of the four terms are

    3 Q^2 / m^2,   N^2 / m,   (2 ln 2 / pi) B^2,   K^2 (m / 3 + 1 / (6 m))

and weighted least squares determine Q^2, N^2, B^2, K^2, none negative. The last term is that of a random walk sampled
at instants, like the bias state of a filter; a random walk averaged over each step would give K^2 m / 3. The standard
errors take into account that the variances at two cluster times come from the same record (`allan_covariance`). Source:
IEEE Std 952-1997, annex C.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats
from becalm.errors import RecordingError, UsageError
from becalm.identification.at_rest.allan import AllanCurve
from becalm.identification.at_rest.allan_covariance import shapes, spreads
from becalm.identification.at_rest.datasheet import noise_variance

FEWEST_CLUSTER_TIMES = 6
"""Least number of cluster times for a fit."""

_TERM_COST = 9.0  # gain in twice the log-likelihood that each term needs: that of three standard errors
_FORM = 0.02  # relative model error of a variance: four straight lines describe no sensor exactly
_ONE_SIDED_95 = 1.645  # standard errors to the 95 % quantile of a normal distribution
_ROUNDS = 20  # most iterations of the weights

_REASONS = (
    "No quantisation shows at the shortest cluster times.",
    "White noise is not loud enough at any cluster time. Sample faster.",
    "The Allan deviation has no flat stretch that the other terms do not explain: bias instability is undetermined.",
    "The Allan deviation does not rise up to the longest cluster time, {longest:.3g} s: the random walk is "
    "undetermined. A smaller one needs a longer record.",
)


@dataclass(frozen=True)
class NoiseTerm:
    """One coefficient, or the reason why it is undetermined.

    Attributes
    ----------
    value : float
        The coefficient; NaN if this record does not determine it.
    standard_error : float
        Standard error of the value, in its unit; NaN if the value is NaN. It assumes that there are no other terms than
        those found.
    limit : float
        One-sided 95 % upper bound of the coefficient by the normal approximation, also given where there is no value.
        It held for 88 to 100 % of simulated records.
    reason : str
        A sentence on why there is no value; "" where there is one.
    """

    value: float
    standard_error: float
    limit: float
    reason: str = ""


@dataclass(frozen=True)
class NoiseTerms:
    """The terms of a sensor's noise at rest; every density is two-sided.

    Attributes
    ----------
    quantisation : NoiseTerm
        Q, in unit s: noise of each sum theta, as of a gyroscope that counts angles. The rounding of a rate is white
        noise and part of `white`.
    white : NoiseTerm
        N, in unit s^(1/2): angle or velocity random walk; sigma = N / sqrt(tau).
    bias_instability : NoiseTerm
        B, in unit; the flat stretch of the curve lies at 0.664 B.
    random_walk : NoiseTerm
        K, in unit / s^(1/2): rate random walk; sigma = K sqrt(tau / 3).
    misfit : float
        Root mean square of the residuals of the fit, in their standard deviations: about 1 where the four terms
        describe the sensor. Above 2, something else contributes: vibration, a drift of the temperature, a filter within
        the sensor.
    step_s : float
        T, the time between two readings, in seconds.
    """

    quantisation: NoiseTerm
    white: NoiseTerm
    bias_instability: NoiseTerm
    random_walk: NoiseTerm
    misfit: float
    step_s: float

    def deviation(self, cluster_times_s: ArrayLike) -> Floats:
        """Return the Allan deviation (k,) of these terms, in unit, at cluster times (k,) in seconds."""
        sizes = np.asarray(cluster_times_s, dtype=np.float64) / self.step_s
        terms = (self.quantisation, self.white, self.bias_instability, self.random_walk)
        squares = np.nan_to_num([term.value for term in terms]) ** 2 / _units(self.step_s)
        result: Floats = np.sqrt(shapes(sizes) @ squares)
        return result

    def to_noise_variance(self, rate_hz: float) -> float:
        """Return R = N^2 rate, in unit^2: the variance of one reading's white noise at `rate_hz` readings per second.

        Raises
        ------
        UsageError
            If the record does not determine white noise, or the rate is not positive.

        Notes
        -----
        At another rate than the record's, this holds for a sensor that averages between two readings.
        """
        return noise_variance(_value(self.white), rate_hz)

    def to_random_walk_density(self) -> float:
        """Return q = K^2, in unit^2/s: the two-sided density of the noise that drives a wandering bias.

        It is the `noise_density` of `components.level` and of `components.motion(1, q)`; over a step it adds q T.

        Raises
        ------
        UsageError
            If the record does not determine a random walk.

        Notes
        -----
        Bias instability has no finite model and is not part of q. If B is determined and K is not, q = 0 would keep
        the bias constant for ever; (K's `limit`)^2 is the largest q that this record allows.
        """
        return _value(self.random_walk) ** 2


def noise_terms(curve: AllanCurve) -> NoiseTerms:
    """Fit the four terms to an Allan deviation.

    Parameters
    ----------
    curve : AllanCurve
        The deviation at six cluster times or more; octaves are best. Where a filter within the sensor bends the curve,
        give `allan_deviation` only cluster times longer than that filter.

    Raises
    ------
    RecordingError
        If there are fewer cluster times, or a deviation is 0 because the readings do not change.

    Notes
    -----
    The weights come from the fitted variances, so that a variance that is low by chance does not get a large weight; 2
    % of each variance is added as a model error. Every set of terms is fitted, and the likeliest set is the result;
    each of its terms must raise twice the log-likelihood by 9, as a term of three standard errors does. A steady drift
    looks like a random walk: subtract it from the readings first, or leave it if the filter shall follow it.
    """
    if len(curve.deviation) < FEWEST_CLUSTER_TIMES:
        raise RecordingError(
            f"{len(curve.deviation)} cluster times came; {FEWEST_CLUSTER_TIMES} are needed to distinguish kinds of "
            f"noise: give 64 readings or more in a row."
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
        _determined(squares[k] * units[k], errors[k] * units[k])
        if k in kept
        else _undetermined(k, fit.limit(squares, kept, k) * units[k], float(curve.cluster_times_s[-1]))
        for k in range(4)
    )
    return NoiseTerms(quantisation, white, bias_instability, random_walk, fit.misfit(squares), curve.step_s)


class _Fit:
    """A weighted least-squares fit of an Allan variance, in steps and in units of its first value."""

    def __init__(self, curve: AllanCurve) -> None:
        self.variance = (curve.deviation / curve.deviation[0]) ** 2
        self.shapes = shapes(curve.cluster_sizes)
        self.spreads = spreads(tuple(curve.cluster_sizes.tolist()), tuple(curve.counts.tolist()))

    def covariance(self, squares: Floats) -> Floats:
        """Return the covariance (k, k) of the Allan variances if `squares` (4,) are the true coefficients squared."""
        spread: Floats = self.spreads @ squares @ squares
        return spread + np.diag((_FORM * self.shapes @ squares) ** 2)

    def solve(self, kept: list[int]) -> Floats:
        """Return the fitted squares (4,) of the kept terms; 0 for the others."""
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
        """Return minus twice the Gaussian log-likelihood of the variances, plus the cost of each term."""
        root = np.linalg.cholesky(self.covariance(squares))
        residuals = np.linalg.solve(root, self.variance - self.shapes @ squares)
        return float(residuals @ residuals + 2 * np.log(np.diag(root)).sum() + _TERM_COST * np.count_nonzero(squares))

    def errors(self, squares: Floats, columns: list[int]) -> Floats:
        """Return the standard errors of the squares of some terms that are fitted together, if `squares` are true."""
        covariance = self.covariance(squares)
        sigma = np.sqrt(np.diag(covariance))[:, np.newaxis]
        weigh = np.linalg.pinv(self.shapes[:, columns] / sigma, rcond=1e-12) / sigma.T
        result: Floats = np.sqrt(np.diag(weigh @ covariance @ weigh.T))
        return result

    def limit(self, squares: Floats, kept: list[int], term: int) -> float:
        """Return the 95 % upper bound of the square of a term that is not kept, fitted together with the kept terms."""
        columns = [*kept, term]
        sigma = np.sqrt(np.diag(self.covariance(squares)))
        weighted = self.shapes[:, columns] / sigma[:, np.newaxis]
        estimate = float((np.linalg.pinv(weighted, rcond=1e-12) @ (self.variance / sigma))[-1])
        return max(estimate, 0.0) + _ONE_SIDED_95 * float(self.errors(squares, columns)[-1])

    def misfit(self, squares: Floats) -> float:
        """Return the root mean square of the residuals, in standard deviations."""
        residuals = (self.variance - self.shapes @ squares) / np.sqrt(np.diag(self.covariance(squares)))
        return float(np.sqrt(np.mean(residuals**2)))


def _units(step_s: float) -> Floats:
    """Return the factors (4,) that convert Q^2, N^2, B^2, K^2 from units of steps to seconds."""
    return np.array([step_s**2, step_s, 1.0, 1.0 / step_s])


def _determined(square: float, error: float) -> NoiseTerm:
    """Return a term, given the square of its coefficient and the standard error of the square."""
    value = float(np.sqrt(square))
    relative = float(error / (2 * square))
    return NoiseTerm(value, relative * value, value * float(np.exp(_ONE_SIDED_95 * relative)))


def _undetermined(term: int, square: float, longest: float) -> NoiseTerm:
    """Return a term without a value, given the upper bound of its square."""
    limit = float(np.sqrt(square))
    return NoiseTerm(np.nan, np.nan, limit, _REASONS[term].format(longest=longest))


def _value(term: NoiseTerm) -> float:
    """Return the value of a term, or raise a UsageError with the reason why there is none."""
    if np.isnan(term.value):
        raise UsageError(f"{term.reason} Its `limit` may be used in its place.")
    return term.value
