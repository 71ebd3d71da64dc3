"""Settings of classic filters for a fair comparison: equal noise, equal lag, or least error against a truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from scipy.optimize import bisect, minimize_scalar

from becalm.classic.register import HIGHEST, LOWEST, Classic
from becalm.core.arrays import Floats
from becalm.metrics.delay import follow
from becalm.metrics.truth import rms_error

_LONG = 12.0  # settling time of the slowest filter in samples, times the cut-off
_MOST = 1 << 21  # most samples of a test signal
_DRAWS = 40  # random samples for a nonlinear filter, over its settling time
_PRECISION = 1e-4  # tolerance of the logarithm of a cut-off
_SHORTEST = 0.005  # cut-off in periods per record, below which the output of a filter does not change any more
_NEAR = 0.02  # tolerance of the logarithm of the best cut-off
_STRIDE = 0.7  # step of the logarithm of the cut-off in the search for a bracket
_GRID, _FEW = 120, 12  # cut-offs of the first search; the smaller number if `reduces_noise` is False
_SEED = 7  # seed of the random samples


def noise_gain(classic: Classic, cutoff: float) -> float:
    """Return the variance of white noise after a filter over that before it, at a cut-off in cycles per sample."""
    count = _settling(cutoff)
    if classic.linear:
        impulse = np.zeros(2 * count + 1)
        impulse[count] = 1.0
        return float(np.sum(classic.apply(impulse, cutoff) ** 2))
    drawn = np.random.default_rng(_SEED).normal(size=min(_DRAWS * count, _MOST))
    return float(np.mean(classic.apply(drawn, cutoff)[count:] ** 2))


def lag(classic: Classic, cutoff: float) -> float:
    """Return the lag of the output in samples: the delay of a ramp or of a step at half height, whichever is longer.

    `becalm.core.steady.response.Response` defines the lag of a Kalman filter in the same way.
    """
    if not classic.causal:
        return 0.0
    count = _settling(cutoff)
    ramp = np.arange(2.0 * count)
    slow = float(ramp[-1] - classic.apply(ramp, cutoff)[-1])
    step = classic.apply(np.repeat([0.0, 1.0], count), cutoff)[count - 1 :]
    return max(slow, follow(step, 1, 0.0, 1.0).delay_50)


def overshoot(classic: Classic, cutoff: float) -> float:
    """Return the overshoot of the step response, relative to the step, at a cut-off in cycles per sample."""
    count = _settling(cutoff)
    return follow(classic.apply(np.repeat([0.0, 1.0], count), cutoff), count, 0.0, 1.0).overshoot


def equal_noise(classic: Classic, gain: float) -> float:
    """Return the cut-off, in cycles per sample, at which the noise gain, a ratio of variances, is `gain`."""
    return _where(lambda cutoff: noise_gain(classic, cutoff) / gain)


def equal_lag(classic: Classic, samples: float) -> float:
    """Return the cut-off, in cycles per sample, at which the lag of a causal filter is `samples`."""
    return _where(lambda cutoff: samples / max(lag(classic, cutoff), 1e-12))


class Best(NamedTuple):
    """The filter and the cut-off with the least error against a known truth."""

    classic: Classic
    cutoff: float  # in cycles per sample
    signal: Floats  # (N,)
    error: float  # root mean square, in unit


def best_of(classics: Iterable[Classic], z: Floats, truth: Floats) -> Best:
    """Return the filter, in its best setting, with the least error against a known truth (N,) of z (N,)."""
    candidates = []
    for classic in classics:
        cutoff = best_with_truth(classic, z, truth)
        signal = classic.clean(z, cutoff)
        candidates.append(Best(classic, cutoff, signal, rms_error(signal, truth)))
    return min(candidates, key=lambda best: best.error)


def best_with_truth(classic: Classic, z: Floats, truth: Floats) -> float:
    """Return the cut-off, in cycles per sample, at which a filter of z (N,) has the least error against a truth (N,).

    If several cut-offs have the same error, for example because a window is limited by the record, the result is the
    highest one.
    """

    def error(log_cutoff: float) -> float:
        return rms_error(classic.clean(z, float(np.exp(log_cutoff))), truth)

    lowest = max(LOWEST, _SHORTEST / len(z))
    grid = np.linspace(np.log(HIGHEST), np.log(lowest), _GRID if classic.reduces_noise else _FEW)
    best = int(np.argmin([error(each) for each in grid]))
    around = grid[min(best + 1, len(grid) - 1)], grid[max(best - 1, 0)]
    minimum = minimize_scalar(error, bounds=around, method="bounded", options={"xatol": _NEAR})
    return float(np.exp(min(grid[best], float(minimum.x), key=error)))


def _settling(cutoff: float) -> int:
    return int(min(_LONG / cutoff, _MOST / 2)) + 64


def _where(ratio: Callable[[float], float]) -> float:
    """Return the cut-off at which a ratio, which increases with the cut-off, crosses 1; otherwise the nearest limit."""

    def log_ratio(log_cutoff: float) -> float:
        return float(np.log(max(ratio(float(np.exp(log_cutoff))), 1e-300)))

    high = low = float(np.log(HIGHEST))
    while log_ratio(low) > 0:  # the search starts at the fastest filter, because slow filters take longer to evaluate
        high, low = low, low - _STRIDE
        if low < np.log(LOWEST):
            return LOWEST
    return float(np.exp(bisect(log_ratio, low, high, xtol=_PRECISION) if low < high else high))
