"""Classic filters that know the whole record: Butterworth forward and back, and Savitzky-Golay."""

from __future__ import annotations

from scipy.signal import butter, savgol_filter, sosfiltfilt

from becalm.core.arrays import Floats


def butterworth_both_ways(z: Floats, cutoff: float, order: int) -> Floats:
    """Filter z (N,) by a Butterworth low-pass forward and back, without lag.

    Parameters
    ----------
    z : (N,) float array
        Readings.
    cutoff : float
        -3 dB frequency of each way in cycles a sample, 0 to 0.5; a *small* one smooths more.
    order : int
        Of each way, 1 or more.
    """
    filtered: Floats = sosfiltfilt(butter(order, 2 * cutoff, output="sos"), z)
    return filtered


def savitzky_golay(z: Floats, length: int, degree: int) -> Floats:
    """Fit a polynomial of a degree to the `length` (odd) readings of z (N,) around each; a *small* length trusts z."""
    fitted: Floats = savgol_filter(z, length, degree)
    return fitted
