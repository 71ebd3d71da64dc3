"""What a step, and a reading, make of a covariance; equations as in `core/reference/kalman.py`.

For what is known of a filter before any row comes: gains in tables, settled filters, how far a gap is bridged.
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
    """Return the covariance (n, n) after a reading with the gain K (n, m), whatever gain it is: Joseph's form (7)."""
    A = np.eye(model.states) - K @ model.H
    after: Floats = A @ P @ A.T + K @ model.R @ K.T
    return after


def gain_before(P: Floats, model: Model) -> Floats:
    """Return the gain (n, m) of a reading before which the covariance is P (n, n): (4), (5)."""
    PH = P @ model.H.T
    return np.asarray(np.linalg.solve(model.H @ PH + model.R, PH.T).T, dtype=np.float64)
