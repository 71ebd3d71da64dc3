"""The excess of a smoother's error, beside what it is in simulation."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import run_filter
from becalm.core.filter.smoothing import run_smoother
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.identification.likelihood import Tuning
from becalm.identification.spectrum import ToneOscillator
from becalm.identification.trust.tuning_spread import excess_error, powers
from becalm.metrics.whiteness import whiteness

ROWS, RATIO = 200_000, 0.01


def smoothed(tuning: Tuning, z: Floats) -> tuple[Floats, Floats]:
    """Smooth; return the signal and the normalised innovations."""
    component, R = tuning.component, tuning.noise_variance
    model, timeline = component.to_model(1.0, R), elapsed_timeline(component, R, np.ones(len(z)))
    ahead = run_filter(model, timeline, z[:, np.newaxis]).estimate
    return (
        run_smoother(model, timeline, z[:, np.newaxis]).signal[:, 0],
        (ahead.innovations / ahead.innovation_sigma)[:, 0],
    )


@pytest.fixture(scope="module")
def walk() -> tuple[Floats, Floats]:
    rng = np.random.default_rng(1)
    truth = np.cumsum(np.sqrt(RATIO) * rng.normal(size=ROWS))
    return truth, truth + rng.normal(size=ROWS)


@pytest.mark.parametrize("factor", [0.01, 0.1, 10.0, 100.0])
def test_the_excess_is_that_of_the_error_beside_the_true_model(walk: tuple[Floats, Floats], factor: float) -> None:
    truth, z = walk
    best = np.std(smoothed(Tuning(1, RATIO, 1.0, 0), z)[0] - truth)
    wrong = Tuning(1, RATIO * factor, 1.0, 0)
    signal, innovations = smoothed(wrong, z)
    found, nis = whiteness(innovations), float(np.nanmean(innovations**2))
    told = excess_error(wrong, lambda angle: nis * found.predictor.power(angle))
    assert 1 + told == pytest.approx(np.std(signal - truth) / best, rel=0.06)


def test_a_true_model_has_no_excess() -> None:
    assert excess_error(Tuning(2, 1e-4, 3.0, 0), np.ones_like) == pytest.approx(0.0, abs=1e-12)
    assert excess_error(Tuning(2, 0.0, 3.0, 0), np.ones_like) == 0.0


def test_what_is_taken_off_counts_as_noise() -> None:
    angle, tone = np.array([0.3, 1.0]), ToneOscillator(1.0, 0.01, 0.1)
    kept, white = powers(Tuning(1, 0.01, 2.0, 0, tones=(tone,)), angle)
    signal, noise = powers(Tuning(1, 0.01, 2.0, 0, tones=(tone._replace(disturbance=True),)), angle)
    np.testing.assert_allclose(signal + noise, kept + white)
    np.testing.assert_allclose(white, 2.0)
    assert noise[1] > 100
    np.testing.assert_allclose(powers(Tuning(1, 0.01, 2.0, 0), angle)[0], 0.02 / (2 - 2 * np.cos(angle)), rtol=1e-12)


def test_units_do_not_matter() -> None:
    own, huge = (excess_error(Tuning(3, 1e-4, noise, 1), lambda angle: 1 + angle) for noise in (1.0, 1e158))
    assert own > 0.01
    assert huge == pytest.approx(own, rel=1e-9)
