"""Apply each filter that the strain study compares to many noisy records of one signal."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from becalm.classic.causal import butterworth, moving_average
from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipes.steps import in_steps
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.model import Model
from becalm.core.recording import Recording
from becalm.studies.strain.strain_model import Noise, likeliest, strain_model

STEP_S = 0.1  # time between readings
G_BY_TRIAL = 1e-4
"""G of the simulation, in unit^2/s^6, found by trial, because its exponent is illegible in the paper."""

CUTOFF_HZ, ORDER, AVERAGED = 0.3, 4, 100  # cut-off and order of the Butterworth filter; readings in the average


class Records(NamedTuple):
    """Noisy records of one signal."""

    truth: Floats  # (N,)
    readings: Floats  # (N, runs)
    noise_std: float


class MethodOutcome(NamedTuple):
    """The outputs of one method for each record.

    Attributes
    ----------
    outputs : (N, runs) float array
        Outputs for the noisy records.
    followed : (N, runs) float array
        Outputs of the same filters for the signal without noise; their errors are lag and overshoot.
    identified : (runs, 3) float array
        For a filter that was identified from the record: G or, for becalm's filters, the process noise density; the
        standard deviation of the noise; and the kinematic order. NaN for other filters.
    """

    outputs: Floats
    followed: Floats
    identified: Floats


Method = Callable[[Records], MethodOutcome]
"""Function that applies a filter to all records."""


def _each(records: Records, apply: Callable[[Floats], Floats]) -> MethodOutcome:
    """Apply one fixed filter to every record."""
    runs = records.readings.shape[1]
    outputs = np.column_stack([apply(z) for z in records.readings.T])
    return MethodOutcome(outputs, np.column_stack([apply(records.truth)] * runs), np.full((runs, 3), np.nan))


def _readings(records: Records) -> MethodOutcome:
    return _each(records, np.copy)


def _kalman_by_trial(records: Records, from_zero: bool) -> MethodOutcome:
    noise = Noise(G_BY_TRIAL, records.noise_std**2)
    return _each(records, partial(_filtered, strain_model(noise, STEP_S, from_zero=from_zero)))


def _kalman_by_likelihood(records: Records, noise_known: bool) -> MethodOutcome:
    noises = [likeliest(z, STEP_S, records.noise_std**2 if noise_known else None) for z in records.readings.T]
    models = [strain_model(noise, STEP_S) for noise in noises]
    tunings = np.array([[noise.jerk_variance, np.sqrt(noise.noise_variance), 3] for noise in noises])
    return _by_models(records, models, tunings, _filtered)


def _becalm(records: Records, causal: bool) -> MethodOutcome:
    """Clean the records without settings; every record is a channel."""
    cleaned = clean(Recording(records.readings, rate_hz=1 / STEP_S), causal=causal)
    recipes = cleaned.recipe.channel
    in_rows = [in_steps(recipe.motion, STEP_S) for recipe in recipes if recipe.motion is not None]
    models = [tuning.component.to_model(1.0, tuning.noise_variance) for tuning in in_rows]
    tunings = np.array([[own.process_noise_density, own.noise_std, own.order] for own in recipes], dtype=np.float64)
    outcome = _by_models(records, models, tunings, _filtered if causal else _smoothed)
    return outcome._replace(outputs=cleaned.signal.samples)


def _by_models(
    records: Records, models: list[Model], tunings: Floats, apply: Callable[[Model, Floats], Floats]
) -> MethodOutcome:
    outputs = np.column_stack([apply(model, z) for model, z in zip(models, records.readings.T, strict=True)])
    followed = np.column_stack([apply(model, records.truth) for model in models])
    return MethodOutcome(outputs, followed, tunings)


def _filtered(model: Model, z: Floats) -> Floats:
    return kalman_filter(model, z).signal[:, 0]


def _smoothed(model: Model, z: Floats) -> Floats:
    return kalman_smoother(model, z).signal[:, 0]


def _butterworth(records: Records) -> MethodOutcome:
    """Apply a Butterworth low-pass that starts at rest at zero, as the record does."""
    return _each(records, lambda z: butterworth(np.append(0.0, z), CUTOFF_HZ * STEP_S, ORDER)[1:])


def _average(records: Records) -> MethodOutcome:
    """Average the last readings; readings before the record count as zeros."""
    return _each(records, lambda z: moving_average(np.append(np.zeros(AVERAGED), z), AVERAGED)[AVERAGED:])


READINGS = "the readings"
KALMAN = "Kalman, G by trial, R given, from zero"
KALMAN_FLAT = "Kalman, G by trial, R given, from the first readings"
LIKELIEST_G = "Kalman, G by likelihood, R given"
LIKELIEST = "Kalman, G and R by likelihood"
BECALM = "becalm, causal, no settings"
SMOOTHED = "becalm, smoothed, no settings"
BUTTERWORTH = f"Butterworth of order {ORDER} at {CUTOFF_HZ:g} Hz"
AVERAGE = f"average of {AVERAGED} readings"

METHODS: dict[str, Method] = {
    READINGS: _readings,
    KALMAN: partial(_kalman_by_trial, from_zero=True),
    KALMAN_FLAT: partial(_kalman_by_trial, from_zero=False),
    LIKELIEST_G: partial(_kalman_by_likelihood, noise_known=True),
    LIKELIEST: partial(_kalman_by_likelihood, noise_known=False),
    BECALM: partial(_becalm, causal=True),
    SMOOTHED: partial(_becalm, causal=False),
    BUTTERWORTH: _butterworth,
    AVERAGE: _average,
}
"""Every filter, by its name, which includes its given settings."""
