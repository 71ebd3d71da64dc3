"""Simulated walks, and how a tuning cleans them."""

from __future__ import annotations

import numpy as np

import drawn
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import run_filter
from becalm.core.filter.smoothing import run_smoother
from becalm.core.model.components import motion
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.identification.likelihood import Tuning


def draw(order: int, ratio: float, rows: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return a walk and its readings of variance 1, (rows,) each."""
    return drawn.draw(motion(order, ratio).to_model(1.0, 1.0), rows, rng)


def clean(tuning: Tuning, z: Floats, causal: bool) -> tuple[Floats, Floats]:
    """Return signal and sigma, (N,) each."""
    component, R = tuning.component, tuning.noise_variance
    model, timeline = component.to_model(1.0, R), elapsed_timeline(component, R, np.ones(len(z)))
    if causal:
        found = run_filter(model, timeline, z[:, np.newaxis]).estimate
    else:
        found = run_smoother(model, timeline, z[:, np.newaxis])
    return found.signal[:, 0], found.sigma[:, 0]
