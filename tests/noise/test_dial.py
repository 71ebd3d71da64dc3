"""The dial: what is asked of a filter is what sines, steps and noise measure on it."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.cleaning.pipeline import clean, tune
from becalm.core.arrays import Floats
from becalm.core.components import motion
from becalm.core.filtering import kalman_filter
from becalm.core.recording import Recording
from becalm.core.smoothing import kalman_smoother
from becalm.errors import UsageError
from becalm.noise.dial import Dial, turn
from becalm.noise.likelihood import Tuning
from becalm.noise.spectrum import Line

RATE_HZ = 500.0
ORDERS = [1, 2, 3, 4, 5]


def through(tuning: Tuning, z: Floats, causal: bool) -> Floats:
    run = kalman_filter if causal else kalman_smoother
    return run(tuning.component.to_model(1.0, tuning.noise_variance), z).signal[:, 0]


def found(order: int) -> Tuning:
    return Tuning(order, 1e-3, 0.25, 1000, lines=(Line(1.0, 0.01, 1.0),))


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("order", ORDERS)
def test_half_of_the_power_passes_at_the_bandwidth(order: int, causal: bool) -> None:
    tuning = turn(found(order), Dial("bandwidth_hz", 40.0), 1 / RATE_HZ, causal)
    assert (tuning.order, tuning.noise_variance, tuning.lines) == (order, 0.25, ())
    turns = 2 * np.pi * 40.0 / RATE_HZ * np.arange(6000)
    middle = slice(2500, 3500)  # whole periods, the ends forgotten
    parts = [
        2 * np.mean(through(tuning, np.sin(turns), causal)[middle] * wave(turns[middle])) for wave in (np.sin, np.cos)
    ]
    assert np.hypot(*parts) ** 2 == pytest.approx(0.5, rel=0.01)


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("order", ORDERS)
def test_so_much_of_white_noise_is_left(order: int, causal: bool) -> None:
    tuning = turn(found(order), Dial("noise_gain_db", -9.0), 1 / RATE_HZ, causal)
    z = np.random.default_rng(order).normal(size=200_000)
    left = np.var(through(tuning, z, causal)[1000:-1000]) / np.var(z)
    assert 10 * np.log10(left) == pytest.approx(-9.0, abs=0.15)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_no_step_comes_later_than_the_lag(order: int) -> None:
    slow = Tuning(order, 1e-4 ** (2 * order), 1.0, 1000)
    tuning = turn(slow, Dial("max_lag_s", 0.02), 1 / RATE_HZ, causal=True)
    edge = np.repeat([0.0, 1.0], 3000)
    out = kalman_filter(motion(order, tuning.ratio).to_model(1.0, 1.0), edge, sigma=False).signal[:, 0]
    first = int(np.flatnonzero(out >= 0.5)[0])
    crossed = first - (out[first] - 0.5) / (out[first] - out[first - 1])
    assert crossed - 2999.5 <= 10.01
    quick = Tuning(order, 1.0, 1.0, 1000)
    assert turn(quick, Dial("max_lag_s", 0.02), 1 / RATE_HZ, causal=True).ratio == quick.ratio


@pytest.mark.parametrize(
    ("dial", "causal", "says"),
    [
        (Dial("max_lag_s", 0.1), False, "A smoother has no lag"),
        (Dial("max_lag_s", 0.0), True, "positive number of seconds"),
        (Dial("bandwidth_hz", 250.0), True, "less than 250 Hz, half the rate"),
        (Dial("bandwidth_hz", -1.0), False, "less than 250 Hz, half the rate"),
        (Dial("noise_gain_db", 3.0), False, "is not possible"),
        (Dial("noise_gain_db", 3.0), True, "removes no noise"),
        (Dial("noise_gain_db", float("nan")), False, "is not possible"),
    ],
)
def test_what_is_not_possible_is_said(dial: Dial, causal: bool, says: str) -> None:
    slow = Tuning(2, 1e-20, 1.0, 1000)
    with pytest.raises(UsageError, match=says):
        turn(slow, dial, 1 / RATE_HZ, causal)


@pytest.mark.parametrize("causal", [True, False])
def test_a_recording_is_cleaned_with_the_bandwidth_that_was_asked(causal: bool) -> None:
    z = np.cumsum(0.1 * np.random.default_rng(1).normal(size=5000)) + np.random.default_rng(2).normal(size=5000)
    recording = Recording(z, rate_hz=RATE_HZ)
    recipe = tune(recording, causal=causal, dial=Dial("bandwidth_hz", 12.5))
    assert clean(recording, recipe).reports[0].bandwidth_hz == pytest.approx(12.5, rel=0.01)
