"""How far an output trails the truth, and how far it overshoots, as recorded: no filter is asked."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, Integers


def lag_of(signal: Floats, truth: Floats) -> float:
    """Return by how many samples a signal (N,) trails its truth (N,): where they differ least in mean square.

    That is where their correlation is highest, of as many samples as lie beside each other. A parabola through the
    least value and its neighbours tells parts of a sample; beside noise, or of a slow truth, it is told badly. Lags of
    up to half of the record are looked at. NaN where one of them does not change, or the farthest lag differs least.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    known = np.isfinite(signal) & np.isfinite(truth)
    a, b = (np.where(known, values - values[known].mean(), 0.0) for values in (signal, truth))
    if not (np.ptp(a) > 0 and np.ptp(b) > 0):
        return np.nan
    size, most = next_fast_len(2 * len(a)), len(a) // 2
    lags = np.arange(-most, most + 1)
    products = irfft(rfft(a, size) * np.conj(rfft(b, size)), size)[lags]
    late, early = np.maximum(lags, 0), np.maximum(-lags, 0)  # samples that lie beside none
    squares = _sums(a, late, early) + _sums(b, early, late)
    apart = (squares - 2 * products) / (len(a) - late - early)
    best = int(np.argmin(apart))
    if best in (0, len(apart) - 1):
        return np.nan
    before, least, after = apart[best - 1 : best + 2]
    bend = before - 2 * least + after
    return float(lags[best]) + (0.5 * float(before - after) / float(bend) if bend > 0 else 0.0)


def _sums(values: Floats, first: Integers, left: Integers) -> Floats:
    """Return sums of squares without the `first` and the last `left` values."""
    sums = np.concatenate([[0.0], np.cumsum(values**2)])
    return np.asarray(sums[len(values) - left] - sums[first])


class Followed(NamedTuple):
    """How an output followed a step."""

    delay_50: float  # samples from the step to half of its height
    delay_90: float  # to nine tenths
    overshoot: float  # beyond the step, over its height


def follow(signal: Floats, row: int, before: float, after: float) -> Followed:
    """Tell how a signal (N,) followed a step in a row from one level to another, in samples.

    Levels that are never reached are told as inf. A step is drawn as a line from the row before.
    """
    risen = (signal[row - 1 :] - before) / (after - before)
    return Followed(_crossing(risen, 0.5), _crossing(risen, 0.9), max(0.0, float(np.nanmax(risen)) - 1))


def _crossing(risen: Floats, level: float) -> float:
    """Return where a rise first reaches a level, after a step drawn as a line from 0 to 1 does."""
    reached = np.flatnonzero(risen >= level)
    if not len(reached):
        return np.inf
    first = int(reached[0])
    if not first:
        return 0.0
    return float(first - (risen[first] - level) / (risen[first] - risen[first - 1]) - level)
