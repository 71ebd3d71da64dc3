"""The covariance after a prediction and after an update; equations as in `core/reference/kalman.py`.

These functions are for results that do not depend on readings: tables of gains, steady-state filters, gap limits.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.model import Model


def covariance_ahead(P: Floats, model: Model) -> Floats:
    """Return the covariance (..., n, n) of a prediction over one step, F P F' + Q: equation (2)."""
    F = model.F
    ahead: Floats = F @ P @ F.T + model.process_covariance
    return ahead


def covariance_after(P: Floats, K: Floats, model: Model) -> Floats:
    """Return the covariance (n, n) after an update with any gain K (n, m), in Joseph's form: equation (7)."""
    A = np.eye(model.states) - K @ model.H
    after: Floats = A @ P @ A.T + K @ model.R @ K.T
    return after


def gain_before(P: Floats, model: Model) -> Floats:
    """Return the gain (n, m) of an update, for the prior covariance P (n, n): equations (4) and (5)."""
    PH = P @ model.H.T
    return np.asarray(np.linalg.solve(model.H @ PH + model.R, PH.T).T, dtype=np.float64)
