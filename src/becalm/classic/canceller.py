"""The adaptive noise canceller that the car paper improves on: recursive least squares, the reference a high-pass.

What can be foretold of the readings by what a high-pass leaves of them is taken for noise and taken away. Source:
Haykin, Adaptive Filter Theory (1996), chapter 13; Widrow et al., Proceedings of the IEEE 63 (1975) 1692.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfilt

from becalm.core.arrays import Floats

TAPS = 16
"""Weights of the adaptive filter."""

FORGETTING = 0.999
"""Share of what was learnt that is kept a sample; a *small* one follows changes, and is noisy."""

_ROUNDING = 1e-9
_START = 100.0  # over the square of its first value: the inverse correlation before anything is known


def cancel(z: Floats, cutoff: float, taps: int = TAPS, forgetting: float = FORGETTING) -> Floats:
    """Return readings (N,) less what the reference foretells of them.

    Parameters
    ----------
    z : (N,) float array
        The primary signal.
    cutoff : float
        -3 dB frequency of the high-pass that makes the reference, in cycles a sample; a *small* one takes more away.
    taps : int
        Weights.
    forgetting : float
        0 to 1.
    """
    sos = butter(2, 2 * cutoff, "highpass", output="sos")
    primary, left = z - z[0], np.empty(len(z))
    reference = sosfilt(sos, primary)
    weights, inverse = np.zeros(taps), np.zeros((taps, taps))  # of the reference's correlation
    seen = np.lib.stride_tricks.sliding_window_view(np.concatenate([np.zeros(taps - 1), reference]), taps)[:, ::-1]
    for k, u in enumerate(seen):
        if not inverse[0, 0] and abs(u[0]) > _ROUNDING * abs(primary[k]):
            inverse = np.eye(taps) * _START / u[0] ** 2
        told = inverse @ u
        gain = told / (forgetting + u @ told)
        left[k] = primary[k] - weights @ u
        weights = weights + gain * left[k]
        inverse = (inverse - np.outer(gain, told)) / forgetting
        inverse = (inverse + inverse.T) / 2
    return np.asarray(left + z[0])
