"""The filters that the strain study holds beside each other, each over many noisy records of one signal."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from becalm.classic.causal import butterworth, moving_average
from becalm.cleaning.pipeline import clean
from becalm.cleaning.steps import in_steps
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.model import Model
from becalm.core.recording import Recording
from becalm.studies.strain_model import Noise, likeliest, strain_model

STEP_S = 0.1
TRIED = 1e-4
"""G of the simulation in unit^2/s^6, as in the paper, whose printed exponent is lost: found by trial."""

CUTOFF_HZ, ORDER, AVERAGED = 0.3, 4, 100


class Records(NamedTuple):
    """Noisy records of one signal."""

    truth: Floats  # (N,)
    readings: Floats  # (N, runs)
    noise_std: float


class MethodOutcome(NamedTuple):
    """What a filter made of each record.

    Attributes
    ----------
    outputs : (N, runs) float array
        Of the noisy records.
    followed : (N, runs) float array
        Of the signal without noise, by the same filters: what is wrong there is lag and overshoot.
    told : (runs, 3) float array
        Where the filter was tuned on the record: its G or, of becalm's filters, process noise density; the standard
        deviation of the noise; and the order of the motion. NaN where it was not.
    """

    outputs: Floats
    followed: Floats
    told: Floats


Method = Callable[[Records], MethodOutcome]


def _each(records: Records, apply: Callable[[Floats], Floats]) -> MethodOutcome:
    """Apply one fixed filter to every record."""
    runs = records.readings.shape[1]
    outputs = np.column_stack([apply(z) for z in records.readings.T])
    return MethodOutcome(outputs, np.column_stack([apply(records.truth)] * runs), np.full((runs, 3), np.nan))


def _readings(records: Records) -> MethodOutcome:
    return _each(records, np.copy)


def _kalman_by_trial(records: Records, from_zero: bool) -> MethodOutcome:
    noise = Noise(TRIED, records.noise_std**2)
    return _each(records, partial(_filtered, strain_model(noise, STEP_S, from_zero=from_zero)))


def _kalman_by_likelihood(records: Records, noise_known: bool) -> MethodOutcome:
    found = [likeliest(z, STEP_S, records.noise_std**2 if noise_known else None) for z in records.readings.T]
    models = [strain_model(noise, STEP_S) for noise in found]
    told = np.array([[noise.jerk_variance, np.sqrt(noise.noise_variance), 3] for noise in found])
    return _by_models(records, models, told, _filtered)


def _becalm(records: Records, causal: bool) -> MethodOutcome:
    """Clean without being told anything; every record is a channel."""
    cleaned = clean(Recording(records.readings, rate_hz=1 / STEP_S), causal=causal)
    recipes = cleaned.recipe.channel
    tunings = [in_steps(recipe.motion, STEP_S) for recipe in recipes if recipe.motion is not None]
    models = [found.component.to_model(1.0, found.noise_variance) for found in tunings]
    told = np.array([[own.process_noise_density, own.noise_std, own.order] for own in recipes], dtype=np.float64)
    found = _by_models(records, models, told, _filtered if causal else _smoothed)
    return found._replace(outputs=cleaned.signal.samples)


def _by_models(
    records: Records, models: list[Model], told: Floats, apply: Callable[[Model, Floats], Floats]
) -> MethodOutcome:
    outputs = np.column_stack([apply(model, z) for model, z in zip(models, records.readings.T, strict=True)])
    followed = np.column_stack([apply(model, records.truth) for model in models])
    return MethodOutcome(outputs, followed, told)


def _filtered(model: Model, z: Floats) -> Floats:
    return kalman_filter(model, z).signal[:, 0]


def _smoothed(model: Model, z: Floats) -> Floats:
    return kalman_smoother(model, z).signal[:, 0]


def _butterworth(records: Records) -> MethodOutcome:
    """Start at rest at zero, as the record does."""
    return _each(records, lambda z: butterworth(np.append(0.0, z), CUTOFF_HZ * STEP_S, ORDER)[1:])


def _average(records: Records) -> MethodOutcome:
    """Average the last readings; before the record there was nothing but zeros."""
    return _each(records, lambda z: moving_average(np.append(np.zeros(AVERAGED), z), AVERAGED)[AVERAGED:])


READINGS = "the readings"
KALMAN = "Kalman, G by trial, R given, from zero"
KALMAN_FLAT = "Kalman, G by trial, R given, from the first readings"
LIKELIEST_G = "Kalman, G by likelihood, R given"
LIKELIEST = "Kalman, G and R by likelihood"
BECALM = "becalm, causal, nothing told"
SMOOTHED = "becalm, smoothed, nothing told"
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
"""Every filter by what it is told."""
