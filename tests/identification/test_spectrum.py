"""Spectra: of components, against their models; of records, against what smoothers leave."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import welch

from becalm.core.arrays import Floats
from becalm.core.closed_forms import motion_power
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import Component, motion, oscillator
from becalm.identification.cross_validation import residuals_from_spectra
from becalm.identification.spectrum import (
    ToneOscillator,
    binned,
    periodogram,
    pooled,
    sine_spectrum,
    tone_power,
    welch_power,
)

ANGLE = np.geomspace(1e-3, np.pi, 40)


def power_of(component: Component) -> Floats:
    """H (z - F)^-1 Q (z - F)^-H H', at a step of 1."""
    model = component.to_model(1.0, 1.0)
    found = []
    for turn in np.exp(1j * ANGLE):
        row = np.linalg.solve((turn * np.eye(model.states) - model.F).T, model.H[0].astype(complex))
        found.append((row @ model.process_covariance @ row.conj()).real)
    return np.array(found)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_the_power_of_a_motion_is_that_of_its_model(order: int) -> None:
    np.testing.assert_allclose(motion_power(order, ANGLE), power_of(motion(order)), rtol=1e-12)


@pytest.mark.parametrize("damping", [1e-6, 0.01, 2.0])
def test_the_power_of_a_tone_is_that_of_its_model(damping: float) -> None:
    tone = oscillator(0.7 / (2 * np.pi), damping / np.pi, 0.3)
    np.testing.assert_allclose(tone_power(ToneOscillator(0.7, damping, 0.3), ANGLE), power_of(tone), rtol=1e-10)


@pytest.mark.parametrize("spectrum", [sine_spectrum, periodogram])
def test_white_noise_has_its_variance_everywhere(spectrum: object) -> None:
    assert callable(spectrum)
    found = spectrum(1000.0 + 3.0 * np.random.default_rng(1).normal(size=100_000))
    low, high = found.angle < 0.5, found.angle > 2.5
    for part in (low, high):
        mean = float(found.weight[part] @ found.power[part] / found.weight[part].sum())
        assert mean == pytest.approx(9.0, rel=0.05)


def test_gathering_keeps_the_power_and_what_is_near_a_tone() -> None:
    whole = periodogram(np.random.default_rng(2).normal(size=5000))
    some = binned(whole, [ToneOscillator(1.5, 0.01, 1.0)])
    assert some.weight.sum() == len(whole.angle)
    assert some.weight @ some.power == pytest.approx(whole.power.sum(), rel=1e-12)
    assert (some.weight[np.abs(some.angle - 1.5) < 50 * 2 * np.pi / 5000] == 1).all()
    assert len(some.angle) < len(whole.angle) / 5


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_residuals_are_read_off_as_the_smoother_leaves_them(order: int) -> None:
    rng, t = np.random.default_rng(order), np.arange(8192)
    z = 3.0 + 1e-3 * t + np.sin(0.01 * t) + rng.normal(size=len(t))
    ratio = 0.2 ** (2 * order)
    smoothed = kalman_smoother(motion(order, ratio).to_model(1.0, 1.0), z)
    residuals, readings = residuals_from_spectra([z])(order)
    squares, weight = residuals(ratio)
    assert readings == len(z)
    assert squares == pytest.approx(np.mean((z - smoothed.signal[:, 0]) ** 2), rel=5e-3)
    assert weight == pytest.approx(np.mean(smoothed.sigma**2), rel=0.02)


def test_several_stretches_are_pooled() -> None:
    one, other = (sine_spectrum(np.random.default_rng(k).normal(size=2000)) for k in (1, 2))
    both = pooled([one, other])
    assert both.weight.sum() == 4000
    assert len(both.angle) == len(one.angle) + len(other.angle)


@pytest.mark.parametrize("count", [1024, 1500, 5000])
def test_the_mean_power_of_segments_is_that_of_scipy(count: int) -> None:
    z = 3.0 + np.cumsum(np.random.default_rng(count).normal(size=count))
    _, density = welch(z, nperseg=1024)
    density[1:-1] /= 2  # the power of mirrored frequencies is told for each alone
    np.testing.assert_allclose(welch_power(z, np.hanning(1025)[:-1]), density, rtol=1e-9)


def test_the_mean_power_of_segments_of_white_noise_is_its_variance() -> None:
    z = 2.0 * np.random.default_rng(1).normal(size=400_000)
    power = welch_power(z, np.hanning(512))[2:-1]
    assert power.mean() == pytest.approx(4.0, rel=0.01)
    assert power.std() / 4.0 < 0.05
