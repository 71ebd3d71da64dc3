"""Acceleration is what its sensitivity says, axis by axis and across."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from becalm.errors import SensorError
from becalm.sensors.accelerometer import Accelerometer, FullScale, sensitivity_matrix, volts_per_count

CROSS = [[0.0, 2.0, -1.0], [0.5, 0.0, 3.0], [-2.0, 1.5, 0.0]]  # percent


def test_one_axis_by_its_sheet() -> None:
    one = Accelerometer(sensitivity_matrix([0.9856]), np.array([0.1]))  # 985.6 mV/g
    np.testing.assert_allclose(one.acceleration(np.array([[0.1], [1.0856], [-0.8856]])), [[0], [1], [-1]], atol=1e-12)


@given(a=arrays(float, (5, 3), elements=st.floats(-50, 50)), bias=arrays(float, 3, elements=st.floats(-1, 1)))
def test_what_three_axes_hear_is_told_apart(a: np.ndarray, bias: np.ndarray) -> None:
    v = np.array([0.1, -0.2, 0.4])
    S = np.array([[v[i] * (1 if i == j else CROSS[i][j] / 100) for j in range(3)] for i in range(3)])
    readings = np.array([[bias[i] + sum(S[i, j] * row[j] for j in range(3)) for i in range(3)] for row in a])
    triaxial = Accelerometer(sensitivity_matrix(v, CROSS), bias)
    np.testing.assert_allclose(triaxial.acceleration(readings), a, atol=1e-12 * 50 * 100)
    again = Accelerometer.corrected_by(np.linalg.inv(S), bias)
    np.testing.assert_allclose(again.acceleration(readings), a, atol=1e-12 * 50 * 100)


def test_a_missing_axis_takes_only_those_with_it_that_need_it() -> None:
    readings = np.array([[np.nan, 0.2, 0.4]])
    apart = Accelerometer(sensitivity_matrix([0.1, 0.2, 0.4]), np.zeros(3)).acceleration(readings)
    np.testing.assert_array_equal(apart, [[np.nan, 1.0, 1.0]])
    mixed = Accelerometer(sensitivity_matrix([0.1, 0.2, 0.4], CROSS), np.zeros(3)).acceleration(readings)
    assert np.isnan(mixed).all()


def test_a_reading_at_full_scale_is_clipped() -> None:
    v = np.array([-5.0, -4.995, -4.99, 0.0, 4.99, 4.995, 6.0, np.nan])
    np.testing.assert_array_equal(FullScale(-5.0, 5.0).clipped(v), [1, 1, 0, 0, 0, 1, 1, 0])
    np.testing.assert_array_equal(FullScale(0.0, 65_536.0).clipped(6553.6 * (v + 5)), [1, 1, 0, 0, 0, 1, 1, 0])


def test_counts_are_volts() -> None:
    assert volts_per_count(10.0, 16) * 2**15 == 5.0
    for bits in (0, 65, 2.5, True):
        with pytest.raises(SensorError, match="not the resolution"):
            volts_per_count(10.0, bits)  # type: ignore[arg-type]


def test_an_impossible_sensor_is_refused() -> None:
    with pytest.raises(SensorError, match="parallel axes"):
        Accelerometer(np.array([[1.0, 0, 0], [1.0, 1e-9, 0], [0, 0, 1]]), np.zeros(3))
    with pytest.raises(SensorError, match=r"bias has shape \(2,\)"):
        Accelerometer(np.eye(3), np.zeros(2))
    with pytest.raises(SensorError, match="not finite"):
        Accelerometer(np.diag([1.0, np.nan, 1.0]), np.zeros(3))
    with pytest.raises(SensorError, match="does not hold numbers"):
        Accelerometer(np.array([["a"]]), np.zeros(1))
    with pytest.raises(SensorError, match="A sensitivity is 0"):
        sensitivity_matrix([0.1, 0.0, 0.1])


def test_the_sensor_keeps_its_own_numbers() -> None:
    S = np.eye(1)
    sensor = Accelerometer(S, np.zeros(1))
    S[0, 0] = 7.0
    assert sensor.acceleration(np.ones((1, 1))) == 1.0
