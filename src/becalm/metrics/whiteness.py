"""Whether innovations are white, how much of them is still predictable, and whether their size is right."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincc

from becalm.core.arrays import Floats
from becalm.metrics.lagged import MOST_LAGS, LaggedSums
from becalm.metrics.running import Running

LAGS = 20
_PREDICTOR_LAGS = MOST_LAGS
_FREQUENCIES = 501
_READINGS_PER_LAG = 8  # a short sequence is asked fewer questions


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
    """

    p_value: float
    first_correlation: float
    predictable_share: float
    loudest: float | None = None


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
    Ljung and Box, Biometrika 65 (1978) 297. The predictor is that of Levinson and Durbin.
    """
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
    share = 1 - float(prediction_error(correlation))
    chance = foreseen / n
    return Whiteness(p_value, float(correlation[1]), max(0.0, (share - chance) / (1 - chance)), _loudest(correlation))


def _loudest(correlation: Floats) -> float:
    """Return where the spectrum of lagged correlations (l + 1,) is highest, in a Parzen window (Parzen 1961)."""
    place = np.arange(len(correlation)) / len(correlation)
    window = np.where(place < 0.5, 1 - 6 * place**2 * (1 - place), 2 * (1 - place) ** 3)
    cycles = np.linspace(0.0, 0.5, _FREQUENCIES)
    waves = np.cos(2 * np.pi * np.outer(cycles, np.arange(1, len(correlation))))
    return float(cycles[int(np.argmax(waves @ (window * correlation)[1:]))])


def prediction_error(correlation: Floats) -> float:
    """Return the variance left by the best linear predictor, over the variance (Durbin 1960)."""
    error, predictor = 1.0, np.zeros(0)
    for j in range(1, len(correlation)):
        reflection = (correlation[j] - predictor @ correlation[j - 1 : 0 : -1]) / error
        predictor = np.append(predictor - reflection * predictor[::-1], reflection)
        error *= 1 - reflection**2
        if not error > 0:
            return 0.0
    return error


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
