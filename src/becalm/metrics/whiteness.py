"""Tests of the innovations: whether they are white, how predictable they are, and whether their size is right."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.closed_forms import autoregressive_power
from becalm.metrics.lagged import MOST_LAGS, LaggedSums
from becalm.metrics.running import Running

LAGS = 20
_PREDICTOR_LAGS = MOST_LAGS
_CYCLES = np.linspace(0.0, 0.5, 501)
_READINGS_PER_LAG = 8  # short sequences use fewer lags


class Predictor(NamedTuple):
    """A linear predictor of a value: the sum of coefficients[j] times the value j + 1 places earlier.

    Attributes
    ----------
    coefficients : (j,) float array
        Coefficients; empty for white noise.
    error : float
        Variance of the prediction error over the variance of the sequence.
    """

    coefficients: Floats
    error: float

    def share_outside(self, cycles: float, width: float) -> float:
        """Return the predictable share of the variance without a band about a frequency.

        Parameters
        ----------
        cycles, width : float
            Centre and half width of the band, in cycles per value.
        """
        outside = self.power(2 * np.pi * _CYCLES[np.abs(_CYCLES - cycles) > width])
        return 1 - float(np.exp(np.log(outside).mean()) / outside.mean())

    def power(self, angle: Floats) -> Floats:
        """Return the power (k,) of the autoregressive process of the predictor at angles (k,), in radians per value.

        Its average is 1.
        """
        return autoregressive_power(self.coefficients, self.error, angle)


NO_PREDICTOR = Predictor(np.zeros(0), 1.0)


@dataclass(frozen=True)
class Whiteness:
    """Measures of the whiteness of a sequence.

    Attributes
    ----------
    p_value : float
        Ljung-Box test over 20 lags: probability that white noise looks at least as coloured. Long real
        records always fail; `predictable_share` is the size of the effect.
    first_correlation : float
        Correlation of neighbours; positive: the filter is too slow, negative: too fast.
    predictable_share : float
        Share of the innovation power that a linear predictor of 32 lags predicts, less the share that
        it predicts of white noise by chance; 0 to 1.
    loudest : float or None
        Frequency of the maximum of the spectrum from 32 lags, in cycles per value, 0 to 0.5; None if there are too
        few values.
    predictor : Predictor
        The predictor with the number of lags, up to 32, that an information criterion selects; 0 for white noise.
    """

    p_value: float
    first_correlation: float
    predictable_share: float
    loudest: float | None = None
    predictor: Predictor = field(default=NO_PREDICTOR, compare=False)


class RunningWhiteness(Running[LaggedSums]):
    """Computes the whiteness of a sequence that comes in blocks of any length."""

    def __init__(self) -> None:
        super().__init__(LaggedSums(), LaggedSums.extended)

    def result(self) -> Whiteness:
        """Return the `whiteness` of all values so far; more may follow."""
        return judge_whiteness(self.sums())


def whiteness(normalised: Floats) -> Whiteness:
    """Return the whiteness of normalised innovations (N,); NaN is left out, and lags count the other values."""
    running = RunningWhiteness()
    running.add(normalised)
    return running.result()


def judge_whiteness(sums: LaggedSums) -> Whiteness:
    """Return the whiteness of a sequence from its lagged sums.

    Notes
    -----
    Ljung and Box, Biometrika 65 (1978) 297. The predictors are those of Levinson and Durbin.
    """
    from scipy.special import gammaincc

    n = sums.seen
    tested, predicted = min(LAGS, n // _READINGS_PER_LAG), min(_PREDICTOR_LAGS, n // _READINGS_PER_LAG)
    if predicted < 1 or not sums.varies:
        return Whiteness(1.0, 0.0, 0.0)
    covariance = sums.about_mean(predicted)
    if not 0 < covariance[0] < np.inf:  # squares too small or too large for float64
        return Whiteness(1.0, 0.0, 0.0)
    correlation = covariance / covariance[0]
    lags = np.arange(1, tested + 1)
    statistic = n * (n + 2) * float((correlation[1 : tested + 1] ** 2 / (n - lags)).sum())
    p_value = float(gammaincc(tested / 2, statistic / 2))
    every = [NO_PREDICTOR, *predictors(correlation)]
    share, chance = 1 - every[-1].error, predicted / n
    return Whiteness(
        p_value,
        float(correlation[1]),
        max(0.0, (share - chance) / (1 - chance)),
        float(_CYCLES[int(np.argmax(smoothed_power(correlation, _CYCLES)))]),
        min(every, key=lambda predictor: _price(predictor, n)),
    )


def _price(predictor: Predictor, count: int) -> float:
    """Return the Bayesian information criterion of a predictor (Schwarz, Annals of Statistics 6 (1978) 461)."""
    smallest = np.finfo(float).tiny
    return count * float(np.log(max(predictor.error, smallest))) + len(predictor.coefficients) * float(np.log(count))


def smoothed_power(correlation: Floats, cycles: Floats) -> Floats:
    """Return the power (k,), 1 for white noise, at frequencies (k,) in cycles per value, from correlations (l + 1,).

    Notes
    -----
    The spectrum is smoothed by the window of Parzen, Annals of Mathematical Statistics 32 (1961) 167.
    """
    place = np.arange(len(correlation)) / len(correlation)
    window = np.where(place < 0.5, 1 - 6 * place**2 * (1 - place), 2 * (1 - place) ** 3)
    waves = np.cos(2 * np.pi * np.outer(cycles, np.arange(1, len(correlation))))
    power: Floats = 1 + 2 * waves @ (window * correlation)[1:]
    return power


def predictors(correlation: Floats) -> Iterator[Predictor]:
    """Yield the best linear predictors of 1, 2, ... lags, from correlations (l + 1,) (Durbin 1960)."""
    error, coefficients = 1.0, np.zeros(0)
    for j in range(1, len(correlation)):
        reflection = (correlation[j] - coefficients @ correlation[j - 1 : 0 : -1]) / error
        coefficients = np.append(coefficients - reflection * coefficients[::-1], reflection)
        error = max(error * (1 - reflection**2), 0.0)
        yield Predictor(coefficients, float(error))
        if not error > 0:
            return


class Power(NamedTuple):
    """Number of values, and sum of their squares."""

    seen: int = 0
    squares: float = 0.0

    def extended(self, piece: Floats) -> Power:
        """Return the sums with a piece (n,) of finite values added."""
        return Power(self.seen + len(piece), self.squares + float(np.dot(piece, piece)))

    def mean(self) -> float:
        """Return the mean square; NaN if there are no values."""
        return self.squares / self.seen if self.seen else float("nan")


class RunningNis(Running[Power]):
    """Computes the mean squared normalised innovation of a sequence that comes in blocks of any length."""

    def __init__(self) -> None:
        super().__init__(Power(), Power.extended)

    def result(self) -> float:
        """Return the `mean_nis` of all values so far; more may follow."""
        return self.sums().mean()


def mean_nis(normalised: Floats) -> float:
    """Return the mean squared normalised innovation without NaN; 1 if the noise variance is right."""
    running = RunningNis()
    running.add(normalised)
    return running.result()
