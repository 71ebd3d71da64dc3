"""What temperature does to gauges and leads, beside sheets and resistors."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.errors import SensorError
from becalm.sensors.bridge import Bridge
from becalm.sensors.thermal import gauge_factor_at, thermal_output, two_wire_drift


def test_two_copper_wires_drift_as_their_resistance() -> None:
    drift = two_wire_drift(10.0, 10.0, 350.0, 2.1)
    assert 1e6 * drift == pytest.approx(531, abs=0.5)
    change = 10.0 * 0.0039 * 10.0 / 350.0  # in series with the gauge, of a bridge that was balanced before
    ratio = np.array([1 / (2 + change) - 0.5])
    np.testing.assert_allclose(Bridge("quarter I", 2.1).strain(ratio), drift, rtol=1e-12)


def test_thermal_output_is_told_at_a_gauge_factor_of_two() -> None:
    coefficients, warm = [-31.8, 2.77, -6.55e-2, 3.28e-4, -3.26e-7], np.array([24.0, 80.0])
    by_hand = sum(a * warm**k for k, a in enumerate(coefficients))
    np.testing.assert_allclose(thermal_output(coefficients, warm, 2.0), 1e-6 * by_hand, rtol=1e-12)
    np.testing.assert_allclose(thermal_output(coefficients, warm, 2.1), 1e-6 * by_hand * 2 / 2.1, rtol=1e-12)


def test_the_gauge_factor_is_the_sheets_at_its_temperature() -> None:
    np.testing.assert_allclose(gauge_factor_at(np.array([24.0, 124.0]), 2.1, 1.0), [2.1, 2.121], rtol=1e-12)


@pytest.mark.parametrize("coefficients", [[], [1.0] * 6])
def test_a_polynomial_of_another_order_is_refused(coefficients: list[float]) -> None:
    with pytest.raises(SensorError, match="1 to 5"):
        thermal_output(coefficients, np.zeros(2), 2.0)
