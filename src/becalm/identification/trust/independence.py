"""How far apart samples of a clean signal are independent.

The errors of neighbours are alike, so that averaging n of them does not divide sigma by sqrt(n). With rho_k
the correlation of errors k samples apart and L = sum of rho_k over all k, back and ahead, the mean of n >> L
samples has the variance sigma^2 L / n: L is the integrated autocorrelation time (Priestley, Spectral Analysis and Time
Series (1981), 5.3). The noise that a filter passes has a length of its own, 1 / (2 B) with
its noise bandwidth B; but sigma holds what the filter holds back of the signal as well, and of that L knows.
"""

from __future__ import annotations

import numpy as np

from becalm.identification.likelihood import Tuning
from becalm.identification.trust.excess import powers
from becalm.identification.trust.tuning_spread import settled_filter, spectra_of


def independence_steps(tuning: Tuning, causal: bool) -> float | None:
    """Return L, in steps: so many samples tell a mean as well as one independent one.

    Parameters
    ----------
    tuning : Tuning
        In even time.
    causal : bool
        Whether of the filter (True) or of the smoother.

    Returns
    -------
    float or None
        None of a filter that never settles.

    Notes
    -----
    A smoother's errors have the spectrum S R / (S + R), with S of the signal and R of the noise, whose value
    at 0 Hz is sigma^2 L: of a motion R, so that a long mean of smoothed samples is as good as that of the
    readings, and no better. A filter's errors are e[k] = (I - K H) F e[k-1] and white noise, so that
    L = 2 c (I - A)^-1 P c' / (c P c') - 1.
    """
    if not causal:
        found = spectra_of(tuning)
        if found is None:
            return None
        noise = powers(tuning, 2 * np.pi * found.f[:1])[1]  # total - signal would lose it beside a motion
        return float(found.signal[0] / found.total[0] * noise[0] / found.filter.error_variance(np.inf))
    settled = settled_filter(tuning)
    if settled is None:
        return None
    c, loop = settled.row, settled.loop
    P = c @ loop.P_plus @ c.T
    summed = c @ np.linalg.solve(np.eye(len(loop.A)) - loop.A, loop.P_plus @ c.T)
    return float((2 * summed / P)[0, 0]) - 1.0
