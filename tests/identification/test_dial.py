"""The dial: what is asked of a filter is what sines, steps and noise measure on it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from becalm.cleaning.pipeline import clean
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats
from becalm.core.closed_forms import motion_power, ratio_to_cutoff
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import motion
from becalm.core.recording import Recording
from becalm.core.steady.dials import motion_filter
from becalm.errors import UsageError
from becalm.identification.likelihood import Tuning
from becalm.identification.spectrum import ToneOscillator
from becalm.identification.wishes.dial import Dial, ratio_for, tune_by_dial

RATE_HZ = 500.0
ORDERS = [1, 2, 3, 4, 5]


def through(tuning: Tuning, z: Floats, causal: bool) -> Floats:
    run = kalman_filter if causal else kalman_smoother
    return run(tuning.component.to_model(1.0, tuning.noise_variance), z).signal[:, 0]


def found(order: int) -> Tuning:
    return Tuning(order, 1e-3, 0.25, 1000, tones=(ToneOscillator(1.0, 0.01, 1.0),))


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("order", ORDERS)
def test_half_of_the_power_passes_at_the_bandwidth(order: int, causal: bool) -> None:
    tuning = tune_by_dial(found(order), Dial("bandwidth_hz", 40.0), 1 / RATE_HZ, causal)
    assert (tuning.order, tuning.noise_variance, tuning.tones) == (order, 0.25, ())
    turns = 2 * np.pi * 40.0 / RATE_HZ * np.arange(6000)
    middle = slice(2500, 3500)  # whole periods, the ends forgotten
    parts = [
        2 * np.mean(through(tuning, np.sin(turns), causal)[middle] * wave(turns[middle])) for wave in (np.sin, np.cos)
    ]
    assert np.hypot(*parts) ** 2 == pytest.approx(0.5, rel=0.01)


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("order", ORDERS)
def test_so_much_of_white_noise_is_left(order: int, causal: bool) -> None:
    tuning = tune_by_dial(found(order), Dial("noise_gain_db", -9.0), 1 / RATE_HZ, causal)
    z = np.random.default_rng(order).normal(size=200_000)
    left = np.var(through(tuning, z, causal)[1000:-1000]) / np.var(z)
    assert 10 * np.log10(left) == pytest.approx(-9.0, abs=0.15)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_no_step_comes_later_than_the_lag(order: int) -> None:
    slow = Tuning(order, 1e-4 ** (2 * order), 1.0, 1000)
    tuning = tune_by_dial(slow, Dial("max_lag_s", 0.02), 1 / RATE_HZ, causal=True)
    edge = np.repeat([0.0, 1.0], 3000)
    out = kalman_filter(motion(order, tuning.ratio).to_model(1.0, 1.0), edge, sigma=False).signal[:, 0]
    first = int(np.flatnonzero(out >= 0.5)[0])
    crossed = first - (out[first] - 0.5) / (out[first] - out[first - 1])
    assert crossed - 2999.5 <= 10.01
    quick = Tuning(order, 1.0, 1.0, 1000)
    assert tune_by_dial(quick, Dial("max_lag_s", 0.02), 1 / RATE_HZ, causal=True).ratio == quick.ratio


@pytest.mark.parametrize(
    ("dial", "causal", "says"),
    [
        (Dial("max_lag_s", 0.1), False, "A smoother has no lag"),
        (Dial("max_lag_s", 0.0), True, "positive number of seconds"),
        (Dial("bandwidth_hz", 250.0), True, "less than 250 Hz, half the rate"),
        (Dial("bandwidth_hz", -1.0), False, "less than 250 Hz, half the rate"),
        (Dial("noise_gain_db", 3.0), False, "removes no noise"),
        (Dial("noise_gain_db", 3.0), True, "removes no noise"),
        (Dial("noise_gain_db", float("nan")), False, "removes no noise"),
    ],
)
def test_what_is_not_possible_is_said(dial: Dial, causal: bool, says: str) -> None:
    slow = Tuning(2, 1e-20, 1.0, 1000)
    with pytest.raises(UsageError, match=says):
        tune_by_dial(slow, dial, 1 / RATE_HZ, causal)


@pytest.mark.parametrize("causal", [True, False])
def test_a_recording_is_cleaned_with_the_bandwidth_that_was_asked(causal: bool) -> None:
    z = np.cumsum(0.1 * np.random.default_rng(1).normal(size=5000)) + np.random.default_rng(2).normal(size=5000)
    recording = Recording(z, rate_hz=RATE_HZ)
    recipe = tune(recording, causal=causal, wishes=Wishes(Dial("bandwidth_hz", 12.5)))
    assert clean(recording, recipe).reports[0].bandwidth_hz == pytest.approx(12.5, rel=0.01)


@pytest.mark.parametrize("order", ORDERS)
def test_a_smoother_slower_than_can_be_told_is_refused_with_what_is_possible(order: int) -> None:
    """The least that is named is the least that is offered; 30 times that, the smoother passes half the power."""
    with pytest.raises(UsageError, match=rf"order {order}; ask for .* to 50 Hz") as caught:
        ratio_for(order, Dial("bandwidth_hz", 1e-12), 0.01, causal=False)
    least_hz = float(str(caught.value).split("ask for ")[1].split(" to ")[0])
    with pytest.raises(UsageError, match="is not possible"):
        ratio_for(order, Dial("bandwidth_hz", 0.99 * least_hz), 0.01, causal=False)
    assert ratio_for(order, Dial("bandwidth_hz", 1.01 * least_hz), 0.01, causal=False) > 0
    ratio = ratio_for(order, Dial("bandwidth_hz", 30 * least_hz), 0.01, causal=False)
    assert motion_filter(order, ratio).smoother_power([0.3 * least_hz])[0] == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("decibel", [-0.2, -9.0, -25.0])
def test_a_smoother_leaves_exactly_the_noise_that_was_asked(order: int, decibel: float) -> None:
    """Against the sum over all frequencies of what the smoother S / (S + R) passes."""
    ratio = ratio_for(order, Dial("noise_gain_db", decibel), 1.0, causal=False)

    def power(angle: float) -> float:
        return float(1 / (1 + 1 / (ratio * motion_power(order, np.array([angle]))[0])) ** 2)

    left, _ = quad(power, 1e-12, np.pi, points=[ratio_to_cutoff(order, ratio)] if decibel < -1 else None, limit=200)
    assert 10 * np.log10(left / np.pi) == pytest.approx(decibel, abs=1e-6)


def test_what_is_possible_has_its_unit() -> None:
    for dial, unit in ((Dial("max_lag_s", 1e6), "s"), (Dial("noise_gain_db", -200.0), "dB")):
        with pytest.raises(UsageError, match=rf"ask for .* to .* {unit}\.$"):
            ratio_for(2, dial, 0.01)


def test_a_lag_longer_than_the_record_is_refused_unless_it_asks_nothing() -> None:
    slow, quick = Tuning(2, 1e-20, 1.0, 1000), Tuning(2, 1e-4, 1.0, 1000)
    with pytest.raises(UsageError, match="longer than the record, 2 s"):
        tune_by_dial(slow, Dial("max_lag_s", 2.01), 1 / RATE_HZ, causal=True)
    for lag_s in (2.01, 1e9, float("inf")):
        assert tune_by_dial(quick, Dial("max_lag_s", lag_s), 1 / RATE_HZ, causal=True).ratio == quick.ratio
