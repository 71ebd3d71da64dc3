"""Magnitudes that are no readings: by a record, by a filter's noise, in files and live."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.filter.fixed_lag_flow import FixedLagFlow
from becalm.core.filter.gate import Gate
from becalm.core.filter.restarting_flow import CausalFlow
from becalm.core.filter.smoothed_flow import SmoothedFlow
from becalm.core.health.faults import Faults, fault_messages
from becalm.core.health.limits import find_limits
from becalm.core.model.components import motion
from becalm.core.model.parts import find_largest, largest_magnitude_for_noise, level_from_first_reading
from becalm.core.online import Online
from becalm.core.reading_verdicts import BEYOND_ANY_SENSOR, Verdict
from becalm.core.rows import EstimatedRows
from flows import flow_of

ROWS = 1024
GATE = Gate(5.0)


def noise(seed: int = 1) -> Floats:
    return np.random.default_rng(seed).normal(size=ROWS)


def told_of(flow: CausalFlow | SmoothedFlow | FixedLagFlow, z: Floats) -> EstimatedRows:
    told = [*flow.push(z, np.ones(len(z))), *flow.finish()]
    return EstimatedRows(*(np.concatenate(arrays, axis=-1) for arrays in zip(*told, strict=True)))


@pytest.mark.parametrize("absurd", [1e12, -1e30, 1e99])
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_an_absurd_value_is_told_from_a_record(absurd: float, offset: float) -> None:
    z = noise() + offset
    assert find_largest(z) == BEYOND_ANY_SENSOR
    z[[0, 7, 8]] = absurd
    assert np.abs(z[1:7]).max() < find_largest(z) < abs(absurd)


@pytest.mark.parametrize("size", [1e3, 1e6])
def test_what_only_is_large_is_left_to_gates(size: float) -> None:
    z = noise()
    z[5] = size
    assert find_largest(z) == BEYOND_ANY_SENSOR


def test_records_of_no_spread_have_no_largest() -> None:
    assert find_largest(np.empty(0)) == BEYOND_ANY_SENSOR
    assert find_largest(np.full(3, np.nan)) == BEYOND_ANY_SENSOR
    assert find_largest(np.full(9, 2.0)) == BEYOND_ANY_SENSOR


def test_rest_and_motion_are_one_record() -> None:
    """Residues of arithmetic at rest, and a motion in every fifth row, 10^17 times larger."""
    z = 1e-17 * noise()
    z[:200] = 1.0
    assert find_largest(z) == BEYOND_ANY_SENSOR


def test_a_channel_tells_what_no_sensor_gives() -> None:
    z = noise()
    z[3] = 1e30
    limits = find_limits(z, np.ones(ROWS), 1.0, 0.01)
    faults = Faults(limits)
    codes = faults.push(z, np.ones(ROWS))
    assert np.flatnonzero(codes == Verdict.OVERRANGE).tolist() == [3]
    assert any("beyond" in sentence for sentence in fault_messages(faults.found, limits, 0.01))


def test_a_reading_that_float64_rounds_by_more_than_the_noise_is_none() -> None:
    assert largest_magnitude_for_noise(0.0) == BEYOND_ANY_SENSOR
    assert largest_magnitude_for_noise(1e300) == BEYOND_ANY_SENSOR
    largest = largest_magnitude_for_noise(4.0)
    assert np.spacing(largest) > 100 * 2.0
    assert largest_magnitude_for_noise(1.0) == pytest.approx(largest / 2)
    assert level_from_first_reading(1e15, 1.0) == 1e15
    assert level_from_first_reading(1e17, 1.0) == 0.0


@pytest.mark.parametrize("kind", ["causal", "smoothed", "lagged"])
@pytest.mark.parametrize("gate", [None, GATE])
@pytest.mark.parametrize("row", [0, 1, 5, 20])
def test_an_absurd_reading_is_as_if_it_had_not_come(kind: str, gate: Gate | None, row: int) -> None:
    part = motion(2, 1e-5)

    def run(value: float) -> EstimatedRows:
        z = noise()
        z[row] = value
        return told_of(
            FixedLagFlow(part, 1.0, lag=5, gate=gate)
            if kind == "lagged"
            else flow_of(part, 1.0, causal=kind == "causal", gate=gate),
            z,
        )

    missing = run(np.nan)
    for value in (1e30, -1e99):
        told = run(value)
        assert told.verdicts[row] == Verdict.OVERRANGE
        assert np.array_equal(told.signal, missing.signal, equal_nan=True)
        assert np.array_equal(told.sigma, missing.sigma)


@pytest.mark.parametrize("size", [1e12, 1e15, 1e18])
@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("row", [0, 1, 5])
def test_a_gate_finds_back_from_whatever_it_believed(order: int, row: int, size: float) -> None:
    """In value, and within 200 readings; a first reading, from which all are told, leaves its own rounding."""
    part, good = motion(order, (2 * np.pi * 0.05) ** (2 * order)), noise()
    z = good.copy()
    z[row] = size
    rounded = 4 * np.spacing(size) if row == 0 and size == level_from_first_reading(size, 1.0) else 1e-3
    right = told_of(flow_of(part, 1.0, causal=True, gate=GATE), good)
    for causal in (True, False):
        told = told_of(flow_of(part, 1.0, causal=causal, gate=GATE), z)
        own = right if causal else told_of(flow_of(part, 1.0, causal=False, gate=GATE), good)
        assert np.abs(told.signal - own.signal)[row + 200 : -200].max() < rounded


@pytest.mark.parametrize("row", [0, 1, 5, 20])
@pytest.mark.parametrize("size", [1e30, 1e99])
def test_live_does_as_a_file_does(row: int, size: float) -> None:
    part, z = motion(2, 1e-5), noise()
    z[row] = size
    online = Online(part.to_model(1.0, 1.0), gate=GATE)
    signal, _ = online.run(z)
    told = told_of(flow_of(part, 1.0, causal=True, gate=GATE), z)
    np.testing.assert_allclose(signal[:, 0][5:], told.signal[5:], rtol=0, atol=1e-10)
    assert online.verdicts is not None
    assert online.verdicts[row] == Verdict.OVERRANGE
