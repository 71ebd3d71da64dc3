"""Spectra: power where it is, and as much as there is."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.metrics.spectrum import VEHICLE_BANDS_HZ, band_powers, spectrogram, welch

RATE_HZ = 500.0
T_S = np.arange(60_000) / RATE_HZ


def test_the_power_of_a_sine_is_in_its_band() -> None:
    found = welch(3 * np.sin(2 * np.pi * 6 * T_S) + 2.0, RATE_HZ, 4096)
    powers = band_powers(found, VEHICLE_BANDS_HZ)
    assert powers["wheels"] == pytest.approx(4.5, rel=0.01)
    assert powers["body"] < 1e-3
    assert powers["sprung and unsprung masses"] < 1e-3


def test_the_density_of_white_noise_is_its_variance_over_the_band() -> None:
    found = welch(0.2 * np.random.default_rng(1).normal(size=len(T_S)), RATE_HZ)
    assert np.median(found.density) == pytest.approx(0.04 / (RATE_HZ / 2), rel=0.05)


def test_a_spectrogram_is_welch_s_spectrum_over_time() -> None:
    """Its mean over time is, and a tone that begins half way is found in the second half only."""
    half_s = T_S[-1] / 2
    z = np.sin(2 * np.pi * 6 * T_S) * (half_s < T_S) + 0.01 * np.random.default_rng(1).normal(size=len(T_S))
    found, whole = spectrogram(z, RATE_HZ, 512), welch(z, RATE_HZ, 512)
    np.testing.assert_allclose(found.density.mean(axis=1), whole.density, rtol=1e-12)
    np.testing.assert_array_equal(found.frequency_hz, whole.frequency_hz)
    there = found.density[np.argmin(np.abs(found.frequency_hz - 6))] > 0.1
    assert not there[found.times_s < half_s - 512 / RATE_HZ].any()
    assert there[found.times_s > half_s + 512 / RATE_HZ].all()
