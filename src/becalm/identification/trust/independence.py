"""Compute how many samples apart the errors of a clean signal are independent.

The errors of neighbours are correlated, so averaging n of them does not divide sigma by sqrt(n). With rho_k the
correlation of errors k samples apart and L the sum of rho_k over all k, negative and positive, the mean of n >> L
samples has the variance sigma^2 L / n. L is the integrated autocorrelation time (Priestley, Spectral Analysis and Time
Series (1981), 5.3). The noise that a filter passes has another length, 1 / (2 B) with its noise bandwidth B; sigma and
L also include the part of the signal that the filter does not pass.
"""

from __future__ import annotations

import numpy as np

from becalm.identification.likelihood import Tuning
from becalm.identification.trust.excess import powers
from becalm.identification.trust.tuning_spread import settled_filter, spectra_of


def independence_steps(tuning: Tuning, causal: bool) -> float | None:
    """Return L in steps: so many samples determine a mean as well as one independent sample.

    Parameters
    ----------
    tuning : Tuning
        A tuning in even time.
    causal : bool
        True for the filter, False for the smoother.

    Returns
    -------
    float or None
        L; None for a filter without a steady state.

    Notes
    -----
    A smoother's errors have the spectrum S R / (S + R), with S of the signal and R of the noise; its value at 0 Hz is
    sigma^2 L. For a motion that value is R, so that a long mean of smoothed samples is exactly as good as that of the
    readings. A filter's errors are e[k] = (I - K H) F e[k-1] plus white noise, so that L = 2 c (I - A)^-1 P c' / (c P
    c') - 1.
    """
    if not causal:
        spectra = spectra_of(tuning)
        if spectra is None:
            return None
        noise = powers(tuning, 2 * np.pi * spectra.f[:1])[
            1
        ]  # total - signal would lose it to rounding next to a motion
        return float(spectra.signal[0] / spectra.total[0] * noise[0] / spectra.filter.error_variance(np.inf))
    steady_filter = settled_filter(tuning)
    if steady_filter is None:
        return None
    c, loop = steady_filter.row, steady_filter.loop
    P = c @ loop.P_plus @ c.T
    summed = c @ np.linalg.solve(np.eye(len(loop.A)) - loop.A, loop.P_plus @ c.T)
    return float((2 * summed / P)[0, 0]) - 1.0
