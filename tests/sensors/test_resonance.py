"""A sensor of the second order, beside its equation of motion and a search."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.resonance import Resonance

K, M, C = 1000.0, 1e-3, 0.4


def test_frequencies_are_those_of_spring_and_mass() -> None:
    sensor = Resonance.of_spring(K, M, C)
    assert sensor.natural_hz == pytest.approx(1000 / (2 * np.pi))
    assert sensor.damping_ratio == pytest.approx(0.2)
    assert sensor.ringing_hz == pytest.approx(sensor.natural_hz * np.sqrt(0.96))
    assert np.isnan(Resonance(100.0, 1.0).ringing_hz)
    np.testing.assert_allclose(sensor.acceleration(np.array([1e-6])), [1.0])


@pytest.mark.parametrize("share", [0.3, 1.0, 1.7])
def test_the_response_is_that_of_the_equation_of_motion(share: float) -> None:
    """m dx'' + c dx' + k dx = m sin(w t), run until it has settled, then read as (k/m) dx."""
    sensor = Resonance.of_spring(K, M, C)
    w = 2 * np.pi * share * sensor.natural_hz

    def moved(t: float, y: Floats) -> list[float]:
        return [y[1], np.sin(w * t) - (C * y[1] + K * y[0]) / M]

    period = 2 * np.pi / w
    at = 0.2 + np.arange(200) / 200 * 5 * period
    run = solve_ivp(moved, (0, at[-1]), [0, 0], t_eval=at, rtol=1e-9, atol=1e-15)
    read = sensor.acceleration(run.y[0])
    phasor = 2 * np.mean(read * np.exp(-1j * w * at)) * 1j
    magnitude, phase_deg = sensor.response(np.array([share * sensor.natural_hz]))
    assert abs(phasor) == pytest.approx(magnitude[0], rel=1e-5)
    assert np.degrees(np.angle(phasor)) == pytest.approx(phase_deg[0], abs=1e-3)


@given(damping=st.floats(0, 3), percent=st.floats(0.1, 60))
def test_the_band_ends_where_the_amplitude_is_off(damping: float, percent: float) -> None:
    sensor = Resonance(1000.0, damping)
    edge = sensor.accurate_to_hz(percent)
    within, _ = sensor.response(np.linspace(0, edge * (1 - 1e-6), 2000))
    assert (np.abs(within - 1) <= percent / 100 + 1e-9).all()
    assert abs(sensor.response(np.array([edge * (1 + 1e-6)]))[0][0] - 1) >= percent / 100 * (1 - 1e-3)


def test_a_fifth_of_the_resonance_is_right_within_five_percent() -> None:
    """The rule of thumb of sheets, for a sensor that is hardly damped."""
    assert Resonance(1000.0, 0.02).accurate_to_hz(5.0) == pytest.approx(218, abs=1)


def test_an_undamped_sensor_rings_without_end() -> None:
    assert Resonance(1000.0, 0.0).response(np.array([1000.0]))[0] == np.inf


def test_an_impossible_sensor_is_refused() -> None:
    with pytest.raises(SensorError, match="natural_hz"):
        Resonance(0.0, 0.7)
    with pytest.raises(SensorError, match="damping_ratio"):
        Resonance(10.0, -0.1)
    with pytest.raises(SensorError, match="less than 100"):
        Resonance(10.0, 0.7).accurate_to_hz(100.0)
