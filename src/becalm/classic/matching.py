"""The setting of a classic filter that is fair beside another filter: equal noise, equal lag, or best with truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from scipy.optimize import bisect, minimize_scalar

from becalm.classic.register import HIGHEST, LOWEST, Classic
from becalm.core.arrays import Floats
from becalm.metrics.delay import follow
from becalm.metrics.truth import rms_error

_LONG = 12.0  # over the cut-off: samples in which the slowest filter has settled
_MOST = 1 << 21
_DRAWS = 40  # times the settling, for what is not linear
_PRECISION = 1e-4  # of a cut-off, in its logarithm
_SHORTEST = 0.005  # periods of a cut-off in a record: with fewer, a dial changes nothing any more
_NEAR = 0.02  # of the best cut-off
_STRIDE = 0.7  # from one cut-off to a lower one, in its logarithm
_GRID, _FEW = 120, 12  # cut-offs, before the best is looked for between them; of filters that learn, or are slow
_SEED = 7


def noise_gain(classic: Classic, cutoff: float) -> float:
    """Return the variance of white noise after a filter over before, at a cut-off in cycles a sample."""
    count = _settling(cutoff)
    if classic.linear:
        impulse = np.zeros(2 * count + 1)
        impulse[count] = 1.0
        return float(np.sum(classic.apply(impulse, cutoff) ** 2))
    drawn = np.random.default_rng(_SEED).normal(size=min(_DRAWS * count, _MOST))
    return float(np.mean(classic.apply(drawn, cutoff)[count:] ** 2))


def lag(classic: Classic, cutoff: float) -> float:
    """Return how far the output trails, in samples: of a slow signal or of a step at half height, the longer delay.

    That is how the lag of a Kalman filter is told, see `becalm.core.steady.response.Response`.
    """
    if not classic.causal:
        return 0.0
    count = _settling(cutoff)
    ramp = np.arange(2.0 * count)
    slow = float(ramp[-1] - classic.apply(ramp, cutoff)[-1])
    step = classic.apply(np.repeat([0.0, 1.0], count), cutoff)[count - 1 :]
    return max(slow, follow(step, 1, 0.0, 1.0).delay_50)


def overshoot(classic: Classic, cutoff: float) -> float:
    """Return by which share of its height a filter overshoots a step, at a cut-off in cycles a sample."""
    count = _settling(cutoff)
    return follow(classic.apply(np.repeat([0.0, 1.0], count), cutoff), count, 0.0, 1.0).overshoot


def equal_noise(classic: Classic, gain: float) -> float:
    """Return the cut-off, in cycles a sample, at which a filter leaves a share `gain` of the power of white noise."""
    return _where(lambda cutoff: noise_gain(classic, cutoff) / gain)


def equal_lag(classic: Classic, samples: float) -> float:
    """Return the cut-off, in cycles a sample, at which a causal filter trails by so many samples."""
    return _where(lambda cutoff: samples / max(lag(classic, cutoff), 1e-12))


class Best(NamedTuple):
    """What errs least from a known truth."""

    classic: Classic
    cutoff: float  # in cycles a sample
    signal: Floats  # (N,)
    error: float  # root mean square, in unit


def best_of(classics: Iterable[Classic], z: Floats, truth: Floats) -> Best:
    """Return which of some filters, each in its best setting, errs least from a known truth (N,) of z (N,)."""
    found = []
    for classic in classics:
        cutoff = best_with_truth(classic, z, truth)
        signal = classic.clean(z, cutoff)
        found.append(Best(classic, cutoff, signal, rms_error(signal, truth)))
    return min(found, key=lambda best: best.error)


def best_with_truth(classic: Classic, z: Floats, truth: Floats) -> float:
    """Return the cut-off, in cycles a sample, at which a filter of z (N,) errs least from a known truth (N,).

    Of settings that err alike, as where a window cannot grow any more, the highest.
    """

    def error(log_cutoff: float) -> float:
        return rms_error(classic.clean(z, float(np.exp(log_cutoff))), truth)

    lowest = max(LOWEST, _SHORTEST / len(z))
    grid = np.linspace(np.log(HIGHEST), np.log(lowest), _GRID if classic.calms else _FEW)
    best = int(np.argmin([error(each) for each in grid]))
    around = grid[min(best + 1, len(grid) - 1)], grid[max(best - 1, 0)]
    found = minimize_scalar(error, bounds=around, method="bounded", options={"xatol": _NEAR})
    return float(np.exp(min(grid[best], float(found.x), key=error)))


def _settling(cutoff: float) -> int:
    return int(min(_LONG / cutoff, _MOST / 2)) + 64


def _where(ratio: Callable[[float], float]) -> float:
    """Return the cut-off at which a ratio that grows with it passes 1, as near as the dial allows; or an end."""

    def off(log_cutoff: float) -> float:
        return float(np.log(max(ratio(float(np.exp(log_cutoff))), 1e-300)))

    high = low = float(np.log(HIGHEST))
    while off(low) > 0:  # slow filters take long to look at, so from the quickest on
        high, low = low, low - _STRIDE
        if low < np.log(LOWEST):
            return LOWEST
    return float(np.exp(bisect(off, low, high, xtol=_PRECISION) if low < high else high))
