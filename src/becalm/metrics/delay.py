"""Delay and overshoot of a recorded output relative to the true signal, without knowledge of the filter."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, Integers


def lag_of(signal: Floats, truth: Floats) -> float:
    """Return the lag of a signal (N,) behind its truth (N,), in samples: the shift of least mean square difference.

    Only overlapping samples count; NaN counts as the mean. A parabola through the minimum and its neighbours gives the
    fraction of a sample, which is inaccurate with noise or a slow truth. Lags of up to half of the record in either
    direction are tried. The result is NaN if the signal or the truth is constant, or if the largest lag is the best.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    finite = np.isfinite(signal) & np.isfinite(truth)
    a, b = (np.where(finite, values - values[finite].mean(), 0.0) for values in (signal, truth))
    if not (np.ptp(a) > 0 and np.ptp(b) > 0):
        return np.nan
    size, most = next_fast_len(2 * len(a)), len(a) // 2
    lags = np.arange(-most, most + 1)
    products = irfft(rfft(a, size) * np.conj(rfft(b, size)), size)[lags]
    late, early = np.maximum(lags, 0), np.maximum(-lags, 0)  # samples without a counterpart
    squares = _sums(a, late, early) + _sums(b, early, late)
    differences = (squares - 2 * products) / (len(a) - late - early)
    best = int(np.argmin(differences))
    if best in (0, len(differences) - 1):
        return np.nan
    before, least, after = differences[best - 1 : best + 2]
    curvature = before - 2 * least + after
    return float(lags[best]) + (0.5 * float(before - after) / float(curvature) if curvature > 0 else 0.0)


def _sums(values: Floats, first: Integers, last: Integers) -> Floats:
    """Return sums of squares (l,), each without the first `first` (l,) and the last `last` (l,) values."""
    sums = np.concatenate([[0.0], np.cumsum(values**2)])
    return np.asarray(sums[len(values) - last] - sums[first])


class StepDelays(NamedTuple):
    """Delays and overshoot of the response to a step."""

    delay_50: float  # samples from the step to half of the height
    delay_90: float  # samples to nine tenths of the height
    overshoot: float  # largest value beyond the final level, over the height


def follow(signal: Floats, row: int, before: float, after: float) -> StepDelays:
    """Return delays and overshoot of a signal (N,) after a step at `row` from the level `before` to the level `after`.

    The delay to a level that is never reached is inf. The step counts as a straight line from the row before it.
    """
    risen = (signal[row - 1 :] - before) / (after - before)
    return StepDelays(_crossing(risen, 0.5), _crossing(risen, 0.9), max(0.0, float(np.nanmax(risen)) - 1))


def _crossing(risen: Floats, level: float) -> float:
    """Return the delay at which a rise first reaches a level, relative to a line from 0 to 1 just before the step."""
    reached = np.flatnonzero(risen >= level)
    if not len(reached):
        return np.inf
    first = int(reached[0])
    if not first:
        return 0.0
    return float(first - (risen[first] - level) / (risen[first] - risen[first - 1]) - level)
