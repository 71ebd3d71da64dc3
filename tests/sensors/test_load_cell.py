"""Load is a share of the capacity."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.errors import SensorError
from becalm.sensors.load_cell import LoadCell, weight_n


def test_load_is_the_share_of_the_rated_output() -> None:
    cell = LoadCell(2.0, 500.0, 0.02, 10.0)  # 2 mV/V at 500 kg
    load = cell.load(cell.ratio(np.array([0.2e-3, 10.2e-3, 20.2e-3, np.nan])))
    np.testing.assert_allclose(load, [0, 250, 500, np.nan], atol=1e-12)
    np.testing.assert_allclose(weight_n(load), [0, 2451.6625, 4903.325, np.nan], atol=1e-9)
    np.testing.assert_allclose(LoadCell(-2.0, 500.0).load(np.array([-1.0])), [250])


def test_an_impossible_cell_is_refused() -> None:
    with pytest.raises(SensorError, match="gives no load"):
        LoadCell(0.0, 500.0)
    with pytest.raises(SensorError, match="capacity = -1"):
        LoadCell(2.0, -1.0)
    with pytest.raises(SensorError, match="give excitation_v"):
        LoadCell(2.0, 500.0).ratio(np.zeros(1))
    with pytest.raises(SensorError, match="excitation_v = 0"):
        LoadCell(2.0, 500.0, excitation_v=0)
    with pytest.raises(SensorError, match="gravity"):
        weight_n(np.ones(1), 0.0)
