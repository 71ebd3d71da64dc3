"""Compute the overlapping Allan deviation of a motionless sensor, with confidence intervals.

With theta the cumulative sum of the readings x over a step T, and a cluster of m readings, tau = m T,

    sigma^2(tau) = mean of (theta[k + 2 m] - 2 theta[k + m] + theta[k])^2 / (2 tau^2)

over every k. `allan_terms` fits quantisation, white noise, bias instability and random walk to the curve. Sources: IEEE
Std 952-1997, annex C; Riley, Handbook of Frequency Stability Analysis, NIST SP 1065 (2008), where theta is called phase
and a reading frequency; Riley and Greenhall, 18th EFTF (2004), for the type of noise from the lag-1 autocorrelation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats, Integers, frozen, real
from becalm.core.model.parts import checked_number
from becalm.core.time.clock import FASTEST_HZ, SLOWEST_HZ
from becalm.errors import RecordingError, UsageError

_FEWEST_CLUSTERS = 128  # least number for the lag-1 autocorrelation; with fewer, chance looks like other types of noise
_SLOPE_OF_WALK = 0.25  # delta in Riley and Greenhall above which the clusters are differenced once
_STEEPEST = 2  # largest exponent of f in the spectrum: from -2, random walk, to 2, quantisation
_WHOLE = 1e-6  # relative tolerance of a cluster time that must be a whole number of steps


@dataclass(frozen=True, eq=False)
class AllanCurve:
    """The Allan deviation at k cluster times.

    Attributes
    ----------
    cluster_times_s : (k,) float array
        tau, in seconds, ascending.
    deviation : (k,) float array
        sigma(tau), in the unit of the readings.
    low, high : (k,) float array
        Bounds of the true deviation, in the unit of the readings, with equal probability of error on each side.
    degrees_of_freedom : (k,) float array
        Equivalent degrees of freedom of sigma^2. A *small* number means that the record has few independent clusters of
        this length, so the deviation is unreliable.
    noise_exponent : (k,) int array
        Exponent of the frequency in the noise's spectrum around 1/tau: 2 quantisation, 1 between this and white, 0
        white, -1 bias instability (flicker), -2 random walk or steeper.
    counts : (k,) int array
        Number of second differences averaged.
    step_s : float
        T, the time between two readings, in seconds.
    confidence : float
        Probability that an interval holds the true deviation.
    """

    cluster_times_s: Floats
    deviation: Floats
    low: Floats
    high: Floats
    degrees_of_freedom: Floats
    noise_exponent: Integers
    counts: Integers
    step_s: float
    confidence: float

    @property
    def cluster_sizes(self) -> Integers:
        """Return the numbers (k,) of readings in a cluster, m = tau / T."""
        return np.rint(self.cluster_times_s / self.step_s).astype(np.int64)


def allan_deviation(
    readings: ArrayLike,
    rate_hz: float,
    cluster_times_s: ArrayLike | Literal["octave", "decade"] = "octave",
    confidence: float = 0.95,
) -> AllanCurve:
    """Compute the overlapping Allan deviation of a record taken at rest.

    Parameters
    ----------
    readings : (N,) array_like
        Readings of a rate, an acceleration or a strain, not of its integral. NaN or inf marks a missing reading.
        Differences that need it are left out; a gap affects only cluster times that are about as long as the stretches
        on both sides.
    rate_hz : float
        Readings per second, evenly spaced; missing rows must be present as NaN.
    cluster_times_s : {"octave", "decade"} or (k,) array_like
        Cluster times of 1, 2, 4, 8, ... or 1, 2, 5, 10, ... steps, up to half of the record; or cluster times in
        seconds, each a whole number of steps.
    confidence : float
        Confidence level of the intervals, between 0 and 1; a *small* one makes them narrow.

    Raises
    ------
    RecordingError
        If no two readings are adjacent, or the readings are not one column of numbers.
    UsageError
        If the rate or the confidence is out of range, or a cluster time is not possible.

    Notes
    -----
    Each cluster time costs one pass over the record. The intervals are those of chi-square with the degrees of freedom
    of NIST SP 1065, section 5.4, for the type of noise at that cluster time. At a cluster time with under 128 clusters,
    the type is that of the longest cluster time with 128 or more, or white if there is none.
    """
    x = _column(readings)
    rate_hz = checked_number("rate_hz", rate_hz, "a rate", "the number of readings per second")
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise UsageError(
            f"rate_hz = {rate_hz} is not a rate; give the number of readings per second, for instance 100.0."
        )
    if not checked_number("confidence", confidence, "between 0 and 1", "for instance 0.95") < 1:
        raise UsageError(f"confidence = {confidence} is not between 0 and 1; give for instance 0.95.")
    series = cluster_times_s if isinstance(cluster_times_s, str) else None
    sizes = _series(series, len(x)) if series else _whole_steps(cluster_times_s, rate_hz, len(x))
    theta, absent = _sums(x)
    mean_squares, counts = np.array([_mean_square(theta, absent, int(m)) for m in sizes]).T
    if not series and not counts.all():
        longest = sizes[counts == 0][0] / rate_hz
        raise UsageError(f"No stretch without a gap is twice as long as {longest:g} s; leave this cluster time out.")
    if not counts.any():
        raise RecordingError(
            "An Allan deviation needs consecutive readings, and there are no two; give the record as it was sampled."
        )
    sizes, mean_squares, counts = (each[counts > 0] for each in (sizes, mean_squares, counts))
    exponents = _exponents(theta, absent, sizes)
    freedom = np.array([_freedom(*each) for each in zip(exponents, sizes, counts, strict=True)])
    deviation = np.sqrt(mean_squares / 2) / sizes
    upper, lower = (_chi_square(freedom, p) for p in ((1 + confidence) / 2, (1 - confidence) / 2))
    return AllanCurve(
        cluster_times_s=frozen(sizes / rate_hz),
        deviation=frozen(deviation),
        low=frozen(deviation * np.sqrt(freedom / upper)),
        high=frozen(deviation * np.sqrt(freedom / lower)),
        degrees_of_freedom=frozen(freedom),
        noise_exponent=exponents,
        counts=counts.astype(np.int64),
        step_s=1.0 / rate_hz,
        confidence=confidence,
    )


def _column(readings: ArrayLike) -> Floats:
    """Return readings as an array (N,), or raise a RecordingError if they are not one column of numbers."""
    try:
        x = np.asarray(real(readings), dtype=np.float64)
    except (TypeError, ValueError) as cause:
        raise RecordingError(f"readings are not numbers ({cause}).") from cause
    if x.ndim != 1:
        raise RecordingError(f"readings have shape {x.shape}; one channel, (N,), is needed: give readings[:, 0].")
    return x


def _sums(x: Floats) -> tuple[Floats, Integers]:
    """Return theta (N + 1,), the sum of the readings about their mean, and how many are missing before each point."""
    finite = np.isfinite(x)
    mean = x.mean(where=finite) if finite.any() else 0.0
    theta = np.cumsum(np.append(0.0, np.where(finite, x - mean, 0.0)))
    return theta, np.cumsum(np.append(0, ~finite))


def _mean_square(theta: Floats, absent: Integers, m: int) -> tuple[float, int]:
    """Return the mean square of the second differences of theta over m readings, and how many there are."""
    if 2 * m >= len(theta):
        return 0.0, 0
    sums = theta[m:] - theta[:-m]
    z = sums[m:] - sums[:-m]
    if absent[-1]:
        z = z[absent[2 * m :] == absent[: -2 * m]]
    return float(np.vecdot(z, z)) / max(len(z), 1), len(z)


def _series(name: str, count: int) -> Integers:
    """Return the cluster sizes of a named series, up to half of the record."""
    if name not in ("octave", "decade"):
        raise UsageError(f"cluster_times_s = {name!r} is not a series; use 'octave', 'decade', or times in seconds.")
    factors = np.array([1]) if name == "octave" else np.array([1, 2, 5])
    base = 2 if name == "octave" else 10
    sizes = np.multiply.outer(base ** np.arange(60 if base == 2 else 18), factors).ravel()
    result: Integers = sizes[sizes <= max(count // 2, 1)].astype(np.int64)
    return result


def _whole_steps(cluster_times_s: ArrayLike, rate_hz: float, count: int) -> Integers:
    """Convert cluster times in seconds to numbers of readings."""
    try:
        steps = np.unique(np.asarray(real(cluster_times_s), dtype=np.float64).ravel() * rate_hz)
    except (TypeError, ValueError) as cause:
        raise UsageError(f"cluster_times_s does not hold numbers of seconds ({cause}).") from cause
    if not len(steps):
        raise UsageError("cluster_times_s is empty; give times in seconds, or 'octave'.")
    for step in steps:
        if not (0.5 < step <= count / 2 + 0.5):
            raise UsageError(
                f"A cluster time of {step / rate_hz:g} s is not possible with {count} readings at {rate_hz:g} Hz; "
                f"give {1 / rate_hz:g} to {count // 2 / rate_hz:g} s."
            )
        if abs(step - round(step)) > _WHOLE * step:
            raise UsageError(
                f"A cluster time of {step / rate_hz:g} s is not a whole number of steps of {1 / rate_hz:g} s; "
                f"the nearest is {round(step) / rate_hz:g} s."
            )
    sizes: Integers = np.unique(np.rint(steps)).astype(np.int64)
    return sizes


def _exponents(theta: Floats, absent: Integers, sizes: Integers) -> Integers:
    """Return the noise exponent at each cluster size; with too few clusters, it is that of the previous size."""
    exponent, exponents = 0, []
    for m in sizes:
        means = np.diff(theta[::m]) / m
        means[np.diff(absent[::m]) > 0] = np.nan
        if np.count_nonzero(np.isfinite(means)) >= _FEWEST_CLUSTERS:
            exponent = _exponent(means)
        exponents.append(exponent)
    return np.array(exponents, dtype=np.int64)


def _exponent(means: Floats) -> int:
    """Return the noise exponent from the means of adjacent clusters, which are NaN where unknown."""
    delta, differenced = _delta(means), 0
    if delta >= _SLOPE_OF_WALK:
        delta, differenced = _delta(np.diff(means)), 1
    return int(np.clip(np.rint(-2 * (delta + differenced)), -_STEEPEST, _STEEPEST))


def _delta(y: Floats) -> float:
    """Return the order of fractional integration, r / (1 + r), from the autocorrelation r at lag 1."""
    c = np.nan_to_num(y - np.nanmean(y))
    power = float(np.vecdot(c, c))
    r = float(np.vecdot(c[1:], c[:-1])) / power if power else 0.0
    return r / (1 + r)


def _freedom(exponent: int, m: int, count: int) -> float:
    """Return the equivalent degrees of freedom of `count` overlapping differences (NIST SP 1065, table 5)."""
    n = count + 2.0 * m  # points of theta
    if exponent == 2:
        edf = (n + 1) * (n - 2 * m) / (2 * (n - m))
    elif exponent == 1:
        edf = np.exp(np.sqrt(np.log((n - 1) / (2 * m)) * np.log((2 * m + 1) * (n - 1) / 4)))
    elif exponent == 0:
        edf = (3 * (n - 1) / (2 * m) - 2 * (n - 2) / n) * 4 * m**2 / (4 * m**2 + 5)
    elif exponent == -1:
        edf = 2 * (n - 2) ** 2 / (2.3 * n - 4.9) if m == 1 else 5 * n**2 / (4 * m * (n + 3 * m))
    else:
        edf = (n - 2) / m * ((n - 1) ** 2 - 3 * m * (n - 1) + 4 * m**2) / max(n - 3, 1) ** 2
    return float(np.clip(edf, 1.0, count))


def _chi_square(freedom: Floats, probability: float) -> Floats:
    """Return the quantile of chi-square at a probability."""
    from scipy.special import gammaincinv

    return np.asarray(2 * gammaincinv(freedom / 2, probability), dtype=np.float64)
