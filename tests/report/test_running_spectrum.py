"""Spectra of sequences that come in blocks: against Welch's, Parseval, and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter, welch

from becalm.core.arrays import Floats
from becalm.metrics.whiteness import smoothed_power
from becalm.report.data.spectra import RunningSpectrum

RATE_HZ = 50.0


def white(rows: int, std: float = 1.0) -> Floats:
    return np.random.default_rng(7).normal(scale=std, size=rows)


@pytest.mark.parametrize(("rows", "segment"), [(200, 16), (4096, 512), (32_768, 4096)])
def test_a_short_record_has_welch_s_spectrum(rows: int, segment: int) -> None:
    values = np.cumsum(white(rows))
    running = RunningSpectrum(len(values), RATE_HZ)
    running.add(values)
    found = running.result()
    assert found is not None
    frequency_hz, density = welch(values, RATE_HZ, nperseg=segment)
    np.testing.assert_allclose(found.frequency_hz, frequency_hz[1:], rtol=1e-12)
    np.testing.assert_allclose(found.density, density[1:], rtol=1e-9)


@pytest.mark.parametrize("rows", [20_000, 600_000])
def test_the_density_of_white_noise_adds_up_to_its_variance(rows: int) -> None:
    running = RunningSpectrum(rows, RATE_HZ)
    for block in np.array_split(white(rows, 3.0), max(1, rows // 100_000)):
        running.add(block)
    found = running.result()
    assert found is not None
    step_hz = found.frequency_hz[1] - found.frequency_hz[0]
    assert found.density.sum() * step_hz == pytest.approx(9.0, rel=0.02)


def test_segments_with_holes_are_left_out() -> None:
    values = white(4096)
    holed, running, alone = values.copy(), RunningSpectrum(4096, RATE_HZ), RunningSpectrum(4096, RATE_HZ)
    holed[2000] = np.nan
    running.add(holed)
    for start in [0, 256, 512, 768, 1024, 1280, *range(2048, 3585, 256)]:  # 512 long, none with row 2000
        alone.add(values[start : start + 512])
    found, expected = running.result(), alone.result()
    assert found is not None
    assert expected is not None
    np.testing.assert_allclose(found.density, expected.density, rtol=1e-12)


@pytest.mark.parametrize("values", [white(15), np.full(500, np.nan), np.where(np.arange(500) % 9, white(500), np.nan)])
def test_without_a_whole_segment_there_is_none(values: Floats) -> None:
    running = RunningSpectrum(len(values), RATE_HZ)
    running.add(values)
    assert running.result() is None


def test_the_smoothed_power_of_white_noise_is_one() -> None:
    power = smoothed_power(np.append(1.0, np.zeros(32)), np.linspace(0, 0.5, 251))
    np.testing.assert_array_equal(power, 1.0)


@pytest.mark.parametrize("phi", [0.5, -0.4])
def test_the_smoothed_power_of_an_autoregression_is_near_its_closed_form(phi: float) -> None:
    cycles = np.linspace(0, 0.5, 251)
    closed = (1 - phi**2) / (1 - 2 * phi * np.cos(2 * np.pi * cycles) + phi**2)
    power = smoothed_power(phi ** np.arange(33.0), cycles)
    np.testing.assert_allclose(power, closed, rtol=0.05)  # 32 lags smooth its peak
    assert power.mean() == pytest.approx(1.0, abs=0.02)


def test_the_smoothed_power_of_a_record_is_that_of_its_source() -> None:
    phi, cycles = 0.5, np.linspace(0, 0.5, 251)
    values = lfilter([1.0], [1.0, -phi], white(400_000))
    correlation = np.array([values[lag:] @ values[: len(values) - lag] for lag in range(33)])
    closed = (1 - phi**2) / (1 - 2 * phi * np.cos(2 * np.pi * cycles) + phi**2)
    np.testing.assert_allclose(smoothed_power(correlation / correlation[0], cycles), closed, rtol=0.08)
