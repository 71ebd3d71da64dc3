"""A band beyond the one in which a sensor's amplitudes are right is said, and no other."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.cleaning.channels.slopes import resonance_warning
from becalm.sensors.resonance import Resonance

SENSOR = Resonance(1000.0, 0.02)


@pytest.mark.parametrize(
    ("passed_hz", "rate_hz", "said"),
    [
        (None, 400.0, ""),
        (None, 1000.0, "a: its rows, at 1000 Hz, contain frequencies up to 500 Hz"),
        (100.0, 1000.0, ""),
        (300.0, 1000.0, "a: its filter passes up to 300 Hz"),
        (np.inf, 400.0, ""),
    ],
)
def test_a_band_beyond_is_said(passed_hz: float | None, rate_hz: float, said: str) -> None:
    found = resonance_warning("a", SENSOR, passed_hz, rate_hz)
    assert found.startswith(said)
    assert bool(found) == bool(said)


def test_up_to_there_amplitudes_are_right() -> None:
    found = resonance_warning("a", SENSOR, None, 1000.0)
    flat_hz = float(found.split("only up to ")[1].split(" Hz")[0])
    magnitude, _ = SENSOR.response(np.array([flat_hz]))
    assert magnitude[0] == pytest.approx(1.05, abs=1e-3)
