"""The best hand-tuned classic filter there can be: chosen knowing the truth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.classic.causal import butterworth, moving_average
from becalm.classic.zero_phase import butterworth_both_ways, savitzky_golay
from becalm.core.arrays import Floats
from becalm.metrics.truth import rms_error

_ORDERS = (1, 2, 4)
_CUTOFFS = np.geomspace(1e-4, 0.49, 120)
_ODD_LENGTHS = np.unique(np.round(np.geomspace(2, 1500, 100)).astype(int)) * 2 + 1
_DEGREES = (2, 3, 4, 5)
_LENGTHS = np.unique(np.round(np.geomspace(1, 3000, 120)).astype(int))


class Rival(NamedTuple):
    """A classic filter with the setting that has the least error."""

    name: str
    signal: Floats
    error: float


def best_causal(z: Floats, truth: Floats, rate_hz: float) -> Rival:
    """Return the best of Butterworth orders 1, 2, 4 and the moving average, for z (N,) and truth (N,)."""
    rivals = [
        (f"Butterworth {order}, {cutoff * rate_hz:.3g} Hz", butterworth(z, cutoff, order))
        for order in _ORDERS
        for cutoff in _CUTOFFS
    ]
    rivals += [(f"average of {length}", moving_average(z, int(length))) for length in _LENGTHS]
    return _best(rivals, truth)


def best_zero_phase(z: Floats, truth: Floats, rate_hz: float) -> Rival:
    """Return the best of Butterworth orders 1, 2, 4 forward and back and Savitzky-Golay, for z (N,) and truth (N,)."""
    rivals = [
        (f"Butterworth {order} both ways, {cutoff * rate_hz:.3g} Hz", butterworth_both_ways(z, cutoff, order))
        for order in _ORDERS
        for cutoff in _CUTOFFS
    ]
    rivals += [
        (f"Savitzky-Golay {degree}, {length}", savitzky_golay(z, int(length), degree))
        for degree in _DEGREES
        for length in _ODD_LENGTHS
        if degree < length <= len(z)
    ]
    return _best(rivals, truth)


def _best(rivals: list[tuple[str, Floats]], truth: Floats) -> Rival:
    return min((Rival(name, signal, rms_error(signal, truth)) for name, signal in rivals), key=lambda r: r.error)
