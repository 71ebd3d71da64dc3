"""Disturbances: read, but no part of the signal; the output is split into what its parts say."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.filter.channel import Channel, parts_of
from becalm.core.filter.channel_settings import ChannelSettings
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothed_flow import SmoothedFlow
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.health.limits import Limits
from becalm.core.health.monitor import NO_ALARMS
from becalm.core.model.components import Component, autoregressive, hum, motion
from becalm.core.model.model import Model
from becalm.core.rows import EstimatedRows

ROWS = 3000
COMPONENTS = {
    "hum": motion(2, 1e-4) + hum(0.06, 1, 1e-4),
    "coloured": motion(1, 1e-3) + autoregressive((0.8,), 0.7),
}


def readings(missing: bool) -> Floats:
    rng, k = np.random.default_rng(3), np.arange(ROWS)
    z: Floats = 5.0 + np.sin(k / 200) + 0.6 * np.sin(2 * np.pi * 0.06 * k) + rng.normal(size=ROWS)
    if missing:
        z[rng.random(ROWS) < 0.05] = np.nan
        z[1200:1500] = np.nan
    return z


def flow(component: Component, z: Floats, causal: bool, rows: int) -> EstimatedRows:
    pieces = [z[start : start + rows] for start in range(0, len(z), rows)]
    if causal:
        channel = Channel(ChannelSettings(component, 1.0, 1.0, Limits(), NO_ALARMS))
        found = [channel.process(piece, np.ones(len(piece)), states=True) for piece in pieces]
        return EstimatedRows.joined([each.to_rows()._replace(parts=parts_of(component, each)) for each in found])
    made = SmoothedFlow(component, 1.0, split=True)
    told = [part for piece in pieces for part in made.push(piece, np.ones(len(piece)))]
    return EstimatedRows.joined([*told, *made.finish()])


def beside_a_blind_sensor(component: Component) -> Model:
    """Read the sum, and, with a second sensor that never says anything, the signal alone."""
    one = component.to_model(1.0, 1.0)
    return Model(F=one.F, H=np.vstack([one.H, component.signal_output]), Q=one.Q, R=np.eye(2), known=component.known)


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("component", COMPONENTS.values(), ids=COMPONENTS)
def test_the_signal_is_what_a_blind_sensor_of_it_is_told(component: Component, missing: bool, causal: bool) -> None:
    z = readings(missing)
    two = np.column_stack([z, np.full(ROWS, np.nan)])
    expected = (kalman_filter if causal else kalman_smoother)(beside_a_blind_sensor(component), two)
    found = flow(component, z, causal, ROWS)
    known = slice(10, None)
    np.testing.assert_allclose(found.signal[known], expected.signal[known, 1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.sigma[known], expected.sigma[known, 1], rtol=1e-9)


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("component", COMPONENTS.values(), ids=COMPONENTS)
def test_parts_add_up(component: Component, causal: bool) -> None:
    z = readings(missing=True)
    found = flow(component, z, causal, ROWS)
    assert found.parts.shape == (len(component.parts), ROWS)
    np.testing.assert_allclose(found.parts[0, 10:], found.signal[10:], rtol=1e-12)
    whole = (kalman_filter if causal else kalman_smoother)(component.to_model(1.0, 1.0), z).signal[10:, 0]
    np.testing.assert_allclose(found.parts.sum(axis=0)[10:], whole, rtol=1e-9)


@pytest.mark.parametrize("causal", [True, False])
def test_stretches_give_the_bits_of_the_whole(causal: bool) -> None:
    z, component = readings(missing=True), COMPONENTS["hum"]
    whole, cut = flow(component, z, causal, ROWS), flow(component, z, causal, 512)
    for one, other in zip(whole, cut, strict=True):
        np.testing.assert_array_equal(one, other)
