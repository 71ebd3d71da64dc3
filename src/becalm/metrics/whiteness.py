"""Whether innovations are white, how much of them is still predictable, and whether their size is right."""

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
_READINGS_PER_LAG = 8  # a short sequence is asked fewer questions


class Predictor(NamedTuple):
    """Foretells a value from those before it: the sum of coefficients[j] times the value j + 1 earlier.

    Attributes
    ----------
    coefficients : (j,) float array
        None of white noise.
    error : float
        Variance that is left, over the variance.
    """

    coefficients: Floats
    error: float

    def share_outside(self, cycles: float, width: float) -> float:
        """Return the share of the variance that would be foretold if a band about a frequency were like the rest.

        Parameters
        ----------
        cycles, width : float
            The band's middle and its half width, in cycles a value.
        """
        outside = self.power(2 * np.pi * _CYCLES[np.abs(_CYCLES - cycles) > width])
        return 1 - float(np.exp(np.log(outside).mean()) / outside.mean())

    def power(self, angle: Floats) -> Floats:
        """Return the power (k,) of what it foretells best, at angles (k,) in radians a value; 1 on average."""
        return autoregressive_power(self.coefficients, self.error, angle)


NO_PREDICTOR = Predictor(np.zeros(0), 1.0)


@dataclass(frozen=True)
class Whiteness:
    """How white a sequence is.

    Attributes
    ----------
    p_value : float
        Ljung-Box over 20 lags: how often white noise looks as coloured as this. Long real records
        always fail it; the size of the effect is `predictable_share`.
    first_correlation : float
        Of neighbours; positive: the filter is sluggish, negative: nervous.
    predictable_share : float
        Share of the innovation power that a linear predictor of 32 lags still foresees, less what
        it foresees of white noise by chance; 0 to 1.
    loudest : float or None
        Where their spectrum, as 32 lags tell it, is highest: in cycles a value, 0 to 0.5; None where too few came.
    predictor : Predictor
        Of as many lags, up to 32, as pay for themselves; none of white noise.
    """

    p_value: float
    first_correlation: float
    predictable_share: float
    loudest: float | None = None
    predictor: Predictor = field(default=NO_PREDICTOR, compare=False)


class RunningWhiteness(Running[LaggedSums]):
    """The whiteness of a sequence that comes in blocks of any length."""

    def __init__(self) -> None:
        super().__init__(LaggedSums(), LaggedSums.extended)

    def result(self) -> Whiteness:
        """Return `whiteness` of all values so far; more may follow."""
        return judge_whiteness(self.sums())


def whiteness(normalised: Floats) -> Whiteness:
    """Judge a sequence (N,) of normalised innovations; NaN is left out, and lags run over the others."""
    running = RunningWhiteness()
    running.add(normalised)
    return running.result()


def judge_whiteness(sums: LaggedSums) -> Whiteness:
    """Judge a sequence by its lagged sums.

    Notes
    -----
    Ljung and Box, Biometrika 65 (1978) 297. The predictors are those of Levinson and Durbin.
    """
    from scipy.special import gammaincc

    n = sums.seen
    tested, foreseen = min(LAGS, n // _READINGS_PER_LAG), min(_PREDICTOR_LAGS, n // _READINGS_PER_LAG)
    if foreseen < 1 or not sums.varies:
        return Whiteness(1.0, 0.0, 0.0)
    covariance = sums.about_mean(foreseen)
    if not 0 < covariance[0] < np.inf:  # squares too small or too large for float64
        return Whiteness(1.0, 0.0, 0.0)
    correlation = covariance / covariance[0]
    lags = np.arange(1, tested + 1)
    statistic = n * (n + 2) * float((correlation[1 : tested + 1] ** 2 / (n - lags)).sum())
    p_value = float(gammaincc(tested / 2, statistic / 2))
    every = [NO_PREDICTOR, *predictors(correlation)]
    share, chance = 1 - every[-1].error, foreseen / n
    return Whiteness(
        p_value,
        float(correlation[1]),
        max(0.0, (share - chance) / (1 - chance)),
        float(_CYCLES[int(np.argmax(smoothed_power(correlation, _CYCLES)))]),
        min(every, key=lambda predictor: _price(predictor, n)),
    )


def _price(predictor: Predictor, count: int) -> float:
    """Return what a predictor misses, and costs: Bayes's criterion (Schwarz, Annals of Statistics 6 (1978) 461)."""
    smallest = np.finfo(float).tiny
    return count * float(np.log(max(predictor.error, smallest))) + len(predictor.coefficients) * float(np.log(count))


def smoothed_power(correlation: Floats, cycles: Floats) -> Floats:
    """Return the power (k,), 1 of white noise, at frequencies (k,) in cycles a value, from correlations at lags 0 to l.

    Notes
    -----
    Smoothed by the window of Parzen, Annals of Mathematical Statistics 32 (1961) 167.
    """
    place = np.arange(len(correlation)) / len(correlation)
    window = np.where(place < 0.5, 1 - 6 * place**2 * (1 - place), 2 * (1 - place) ** 3)
    waves = np.cos(2 * np.pi * np.outer(cycles, np.arange(1, len(correlation))))
    power: Floats = 1 + 2 * waves @ (window * correlation)[1:]
    return power


def predictors(correlation: Floats) -> Iterator[Predictor]:
    """Find the best linear predictors of 1, 2, ... lags from lagged correlations (l + 1,) (Durbin 1960)."""
    error, coefficients = 1.0, np.zeros(0)
    for j in range(1, len(correlation)):
        reflection = (correlation[j] - coefficients @ correlation[j - 1 : 0 : -1]) / error
        coefficients = np.append(coefficients - reflection * coefficients[::-1], reflection)
        error = max(error * (1 - reflection**2), 0.0)
        yield Predictor(coefficients, float(error))
        if not error > 0:
            return


class Power(NamedTuple):
    """How many values there were, and the sum of their squares."""

    seen: int = 0
    squares: float = 0.0

    def extended(self, piece: Floats) -> Power:
        """Return the sums with a piece (n,) of finite values."""
        return Power(self.seen + len(piece), self.squares + float(np.dot(piece, piece)))

    def mean(self) -> float:
        """Return the mean square; NaN of no values."""
        return self.squares / self.seen if self.seen else float("nan")


class RunningNis(Running[Power]):
    """The mean squared normalised innovation of a sequence that comes in blocks of any length."""

    def __init__(self) -> None:
        super().__init__(Power(), Power.extended)

    def result(self) -> float:
        """Return `mean_nis` of all values so far; more may follow."""
        return self.sums().mean()


def mean_nis(normalised: Floats) -> float:
    """Return the mean squared normalised innovation, NaN left out; 1 when the scale of the noise is right."""
    running = RunningNis()
    running.add(normalised)
    return running.result()
