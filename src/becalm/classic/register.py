"""A table of classic filters, each with one setting: the cut-off in cycles per sample; a *small* one smooths more."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from becalm.classic.bridging import hold_last, interpolate_linearly
from becalm.classic.canceller import cancel
from becalm.classic.causal import butterworth, fading_memory, length_of, moving_average, moving_median
from becalm.classic.zero_phase import (
    butterworth_both_ways,
    centred_average,
    centred_median,
    hampel,
    savitzky_golay,
    whittaker,
)
from becalm.core.arrays import Floats

LOWEST, HIGHEST = 1e-5, 0.49
"""Range of cut-offs, in cycles per sample."""


class Classic(NamedTuple):
    """A classic filter.

    Attributes
    ----------
    name : str
        The usual name of the filter.
    causal : bool
        True if the filter uses no later readings.
    apply : callable
        Function of readings (N,) without gaps and a cut-off in cycles per sample; returns the filtered readings (N,).
    reduces_noise : bool
        True if a lower cut-off always reduces white noise more. False for Hampel's filter, which only removes spikes,
        and for the adaptive canceller.
    linear : bool
        True if the filter is linear, so that its impulse response describes it.
    """

    name: str
    causal: bool
    apply: Callable[[Floats, float], Floats]
    reduces_noise: bool = True
    linear: bool = True

    def clean(self, z: Floats, cutoff: float) -> Floats:
        """Filter readings of one channel.

        Parameters
        ----------
        z : (N,) float array
            Readings, NaN where missing: there a causal filter holds the last reading, and others interpolate linearly.
        cutoff : float
            Cut-off in cycles per sample, 0 to 0.5; a *small* one smooths more.

        Returns
        -------
        (N,) float array
            Filtered readings; all NaN if there are no readings.
        """
        filled = hold_last(z) if self.causal else interpolate_linearly(z)
        return self.apply(filled, cutoff) if np.isfinite(filled).all() else filled.copy()


def _of_length(average: Callable[[Floats, int], Floats], *, odd: bool) -> Callable[[Floats, float], Floats]:
    """Return a window filter as a function of the cut-off; the window is at most as long as the record."""

    def apply(z: Floats, cutoff: float) -> Floats:
        most = len(z) - 1 + len(z) % 2 if odd else len(z)
        return average(z, min(length_of(cutoff, odd), most))

    return apply


def _savitzky_golay(z: Floats, cutoff: float, degree: int) -> Floats:
    """Apply a Savitzky-Golay filter with a cut-off in cycles per sample.

    The length follows Schafer, IEEE Signal Processing Magazine 28(4) (2011) 111.
    """
    half = max(degree // 2 + 1, round(((degree + 1) / (2 * cutoff) + 4.6) / 3.2))
    length = min(2 * half + 1, len(z) - 1 + len(z) % 2)
    return savitzky_golay(z, length, degree) if length > degree else z.copy()


CAUSAL = (
    *(Classic(f"Butterworth {n}", True, partial(butterworth, order=n)) for n in (1, 2, 4)),
    Classic("moving average", True, _of_length(moving_average, odd=False)),
    Classic("moving median", True, _of_length(moving_median, odd=True), linear=False),
    Classic("exponential average", True, partial(fading_memory, order=1)),
    Classic("alpha-beta", True, partial(fading_memory, order=2)),
    Classic("alpha-beta-gamma", True, partial(fading_memory, order=3)),
    Classic("RLS canceller", True, cancel, reduces_noise=False, linear=False),
)

ZERO_PHASE = (
    *(Classic(f"Butterworth {n} both ways", False, partial(butterworth_both_ways, order=n)) for n in (1, 2, 4)),
    Classic("centred average", False, _of_length(centred_average, odd=True)),
    Classic("centred median", False, _of_length(centred_median, odd=True), linear=False),
    *(Classic(f"Savitzky-Golay {degree}", False, partial(_savitzky_golay, degree=degree)) for degree in (2, 3, 4, 5)),
    *(Classic(f"Whittaker {order}", False, partial(whittaker, order=order)) for order in (1, 2, 3)),
    Classic("Hampel", False, _of_length(hampel, odd=True), reduces_noise=False, linear=False),
)

CLASSICS = {classic.name: classic for classic in (*CAUSAL, *ZERO_PHASE)}
"""Every classic filter by its name."""

USUAL = {
    True: tuple(CLASSICS[name] for name in ("Butterworth 1", "Butterworth 2", "Butterworth 4", "moving average")),
    False: tuple(one for one in ZERO_PHASE if one.name.startswith(("Butterworth", "Savitzky-Golay"))),
}
"""The most common filters: causal (True), and for whole records (False)."""
