"""Simulate records from a model, with the truth, for benchmarks and tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from becalm import Model

Floats = NDArray[np.float64]


def draw(model: Model, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return the first state of a model that starts at 0, and readings of this state, (count,) each."""
    w = np.linalg.cholesky(model.process_covariance) @ rng.normal(size=(model.states, count))
    x, truth = np.zeros(model.states), np.empty(count)
    for k in range(count):
        truth[k] = x[0]
        x = model.F @ x + w[:, k]
    return truth, truth + np.sqrt(model.R.item()) * rng.normal(size=count)
