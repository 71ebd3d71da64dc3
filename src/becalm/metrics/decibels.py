"""Signal-to-noise ratio in two conventions of the decibel.

The usual convention is 10 log10 of a ratio of powers. The car paper (Sensors 2001, equations (12) to (14)) uses
20 log10 of a ratio of powers, which is twice the usual value. Always name the convention with the number.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats


def snr_db(signal: Floats, noise: Floats) -> float:
    """Return 10 log10 of the mean square of a signal (N,) over that of its noise (N,); NaN is ignored."""
    return float(10 * np.log10(np.nanmean(signal**2) / np.nanmean(noise**2)))


def snr_paper_db(signal: Floats, noise: Floats) -> float:
    """Return 20 log10 of the ratio of powers in `snr_db`: the car paper's convention, twice the usual decibel."""
    return 2 * snr_db(signal, noise)
