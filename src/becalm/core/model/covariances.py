"""The covariance after a prediction and after an update; equations as in `core/reference/kalman.py`.

They serve all that can be computed before the first row: tables of gains, steady-state filters, limits of gaps.
"""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.model import Model


def covariance_ahead(P: Floats, model: Model) -> Floats:
    """Return the covariance (..., n, n) of a prediction over one step, F P F' + Q (2)."""
    F = model.F
    ahead: Floats = F @ P @ F.T + model.process_covariance
    return ahead


def covariance_after(P: Floats, K: Floats, model: Model) -> Floats:
    """Return the covariance (n, n) after an update with any gain K (n, m), in Joseph's form (7)."""
    A = np.eye(model.states) - K @ model.H
    after: Floats = A @ P @ A.T + K @ model.R @ K.T
    return after


def gain_before(P: Floats, model: Model) -> Floats:
    """Return the gain (n, m) of an update from the prior covariance P (n, n): (4), (5)."""
    PH = P @ model.H.T
    return np.asarray(np.linalg.solve(model.H @ PH + model.R, PH.T).T, dtype=np.float64)
