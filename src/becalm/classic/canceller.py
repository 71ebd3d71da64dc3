"""The adaptive noise canceller that the car paper improves on: recursive least squares with a high-pass reference.

The filter subtracts the part of the readings that their high-pass filtered values predict. Sources: Haykin, Adaptive
Filter Theory (1996), chapter 13; Widrow et al., Proceedings of the IEEE 63 (1975) 1692.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfilt

from becalm.core.arrays import Floats

TAPS = 16
"""Number of weights of the adaptive filter."""

FORGETTING = 0.999
"""Forgetting factor per sample; a *small* one follows changes faster, with more noise."""

_ROUNDING = 1e-9  # share of the primary signal, below which the reference at the start is only rounding
_START = 100.0  # initial inverse correlation, times the square of the first reference value


def cancel(z: Floats, cutoff: float, taps: int = TAPS, forgetting: float = FORGETTING) -> Floats:
    """Return readings (N,) minus their prediction from the high-pass filtered reference.

    Parameters
    ----------
    z : (N,) float array
        The primary signal: readings without gaps.
    cutoff : float
        -3 dB frequency of the high-pass that makes the reference, in cycles per sample; a *small* one removes more.
    taps : int
        Number of weights.
    forgetting : float
        Forgetting factor, 0 to 1.
    """
    sos = butter(2, 2 * cutoff, "highpass", output="sos")
    primary, error = z - z[0], np.empty(len(z))
    reference = sosfilt(sos, primary)
    weights, inverse = np.zeros(taps), np.zeros((taps, taps))  # inverse correlation of the reference
    windows = np.lib.stride_tricks.sliding_window_view(np.concatenate([np.zeros(taps - 1), reference]), taps)[:, ::-1]
    for k, u in enumerate(windows):
        if not inverse[0, 0] and abs(u[0]) > _ROUNDING * abs(primary[k]):
            inverse = np.eye(taps) * _START / u[0] ** 2
        projected = inverse @ u
        gain = projected / (forgetting + u @ projected)
        error[k] = primary[k] - weights @ u
        weights = weights + gain * error[k]
        inverse = (inverse - np.outer(gain, projected)) / forgetting
        inverse = (inverse + inverse.T) / 2
    return np.asarray(error + z[0])
