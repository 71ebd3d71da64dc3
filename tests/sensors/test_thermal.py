"""What temperature does to gauges and leads, beside sheets and resistors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.bridge import Bridge
from becalm.sensors.thermal import GaugeTemperature, gauge_factor_at, thermal_output, two_wire_drift


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


LOT = (-31.8, 2.77, -6.55e-2, 3.28e-4, -3.26e-7)


def warm_gauge(strain: Floats, degc: Floats, offset: float = 0.0) -> Floats:
    """Return the ratios of a quarter bridge whose gauge is strained and warm; R1 is off by `offset`, relatively."""
    factor = 2.1 * (1 + 1.3e-4 * (degc - 24.0))
    expands = 2.0 * 1e-6 * sum(a * degc**k for k, a in enumerate(LOT))  # as the sheet defines it, at G = 2
    gauge = 350.0 * (1 + factor * strain + expands)
    return np.asarray(350.0 / (350.0 + gauge) - 350.0 / (350.0 * (1 + offset) + 350.0))


def test_strain_without_temperature_is_that_of_the_resistors() -> None:
    strain, degc = np.array([0.0, 1e-3, -2e-3, 1e-2]), np.array([24.0, 80.0, -20.0, 150.0])
    read = Bridge("quarter I", 2.1).strain(warm_gauge(strain, degc))
    assert np.abs(read - strain).max() > 50e-6
    sheet = GaugeTemperature(LOT, 1.3, channel="T")
    np.testing.assert_allclose(sheet.corrected(read, degc, 2.1), strain, rtol=1e-11, atol=1e-15)


def test_a_zero_taken_warm_holds_the_thermal_output_of_then() -> None:
    degc = np.array([60.0, 80.0, 10.0])
    strain, zero = np.array([0.0, 1e-3, -2e-3]), float(warm_gauge(np.zeros(1), degc[:1], offset=2e-3)[0])
    bridge = Bridge("quarter I", 2.1).zeroed_at(zero)
    read = bridge.strain(warm_gauge(strain, degc, offset=2e-3))
    sheet = GaugeTemperature(LOT, 1.3, channel="T", zero_degc=60.0)
    np.testing.assert_allclose(sheet.corrected(read, degc, 2.1), strain, rtol=3e-3, atol=1e-12)  # where R1 is off
    whole = GaugeTemperature(LOT, 1.3, channel="T")
    assert abs(whole.corrected(read, degc, 2.1)[0]) > 10e-6


def test_where_the_temperature_is_missing_so_is_the_strain() -> None:
    for sheet in (GaugeTemperature(LOT, channel="T"), GaugeTemperature((), 1.3, channel="T")):
        found = sheet.corrected(np.full(2, 1e-3), np.array([np.nan, 24.0]), 2.1)
        np.testing.assert_array_equal(np.isnan(found), [True, False])


@pytest.mark.parametrize(
    ("said", "sentence"),
    [
        ({"output_um": LOT}, "give either temperature_degc, e.g. 35.0, or temperature_channel"),
        ({"constant_degc": 20.0, "channel": "T"}, "give either"),
        ({"output_um": (1.0,) * 6, "constant_degc": 20.0}, "1 to 5"),
        ({"percent_per_100_k": np.inf, "constant_degc": 20.0}, "percent_per_100_k = inf"),
        ({"constant_degc": np.nan}, "temperature_degc = nan"),
    ],
)
def test_an_impossible_sheet_is_refused(said: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SensorError, match=sentence):
        GaugeTemperature(**said)
