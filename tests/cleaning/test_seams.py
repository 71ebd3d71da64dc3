"""A recording cut in time: filters that stand alike at a seam say the same of every later row, to the bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.cleaning.channels.channels import ChannelCleaner, open_channel
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import (
    ColouredNoiseRecipe,
    GateRecipe,
    LimitsRecipe,
    ModeRecipe,
    SwitchingRecipe,
    TimingRecipe,
    ToneRecipe,
)
from becalm.core.arrays import Floats
from becalm.core.filter.channel import History
from becalm.core.health.monitor import HOPS
from becalm.core.imm.flow import same_state
from becalm.core.rows import EstimatedRows

STEP_S = 0.01
CUT = 4096  # rows that are pushed at once

USUAL: dict[str, Any] = {"name": "a", "model": "motion", "order": 1, "process_noise_density": 4.0, "noise_std": 1.0}
LIMITS = LimitsRecipe(
    low=-40.0, high=40.0, stuck_readings=12, drift_threshold=25.0, dead_variance=0.05, outlier_distance=9.0,
    causal_outlier_distance=12.0, plausible_low=-20.0, plausible_high=40.0, repeats_are_one=True, blank=1.0,
    far_from_0=0.5,
)  # fmt: skip
CHANNELS = {
    "level": ChannelRecipe(**USUAL),
    "gated, watched": ChannelRecipe(**USUAL, gate=GateRecipe(false_alarms_per_hour=60.0), limits=LIMITS),
    "slope": ChannelRecipe(**{**USUAL, "order": 2, "process_noise_density": 40.0}, limits=LIMITS),
    "tone": ChannelRecipe(
        **USUAL, tone=(ToneRecipe(frequency_hz=7.0, bandwidth_hz=0.5, process_noise_density=1.0, disturbance=True),)
    ),
    "coloured": ChannelRecipe(
        **USUAL, coloured_noise=ColouredNoiseRecipe(rate_hz=1 / STEP_S, std=0.5, coefficients=(0.5,))
    ),
    "timed": ChannelRecipe(**USUAL, timing=TimingRecipe(std_s=1e-4, included_std=0.0)),
    "bank": ChannelRecipe(
        **USUAL,
        switching=SwitchingRecipe(
            kind="resting",
            mode=(
                ModeRecipe(name="still", order=1, process_noise_density=1e-3, noise_std=1.0, lasts_s=2.0),
                ModeRecipe(name="moving", order=1, process_noise_density=20.0, noise_std=1.0, lasts_s=1.0),
            ),
        ),
    ),
    "constant": ChannelRecipe(name="a", model="constant", limits=LIMITS),
}


def readings(seed: int, rows: int) -> tuple[Floats, Floats]:
    """Return readings with holes, spikes, a stuck stretch and a quiet one, and the steps before them."""
    rng = np.random.default_rng(seed)
    z = 0.2 * np.cumsum(rng.normal(size=rows)) % 30.0 + rng.normal(size=rows)
    for begin in rng.integers(0, rows, 12):
        z[begin : begin + rng.integers(1, 40)] = np.nan
    z[rng.integers(0, rows, 4)] += 25.0
    z[2 * CUT + 100 : 2 * CUT + 130] = 3.0
    elapsed = np.ones(rows)
    elapsed[rng.integers(1, rows, 3)] = 7.0
    return z, elapsed


def pushed(channel: ChannelCleaner, z: Floats, elapsed: Floats) -> EstimatedRows:
    told = [part for at in range(0, len(z), CUT) for part in channel.push(z[at : at + CUT], elapsed[at : at + CUT])]
    return EstimatedRows(*(np.concatenate(arrays, axis=-1) for arrays in zip(*told, strict=True)))


def same(one: EstimatedRows, other: EstimatedRows) -> bool:
    told = [(getattr(one, name), getattr(other, name)) for name in ("signal", "sigma", "verdicts")]
    return all(np.array_equal(mine, its, equal_nan=True) for mine, its in told)


@pytest.mark.parametrize("name", CHANNELS)
@settings(max_examples=8)
@given(seed=st.integers(0, 1 << 30))
def test_what_is_saved_goes_on_to_the_bit(name: str, seed: int) -> None:
    z, elapsed = readings(seed, 4 * CUT)
    whole = open_channel(CHANNELS[name], STEP_S, 0)
    pushed(whole, z[: 2 * CUT], elapsed[: 2 * CUT])
    held, stood = whole.state_dict(), whole.comparable_state()
    other = open_channel(CHANNELS[name], STEP_S, 0)
    assert held is not None
    assert stood is not None
    other.load_state_dict(held)
    restored = other.comparable_state()
    assert restored is not None
    assert same_state(stood, restored, alive=False)
    assert same(pushed(whole, z[2 * CUT :], elapsed[2 * CUT :]), pushed(other, z[2 * CUT :], elapsed[2 * CUT :]))


@pytest.mark.parametrize("name", CHANNELS)
@settings(max_examples=12)
@given(seed=st.integers(0, 1 << 30), warm=st.integers(1, 8))
def test_filters_that_stand_alike_say_the_same(name: str, seed: int, warm: int) -> None:
    """Whatever went before: one began with the record, one amid of it, and perhaps too late to stand alike."""
    z, elapsed = readings(seed, 6 * CUT)
    seam = 3 * CUT
    begin = seam - 256 * warm
    whole, later = open_channel(CHANNELS[name], STEP_S, 0), open_channel(CHANNELS[name], STEP_S, 0)
    pushed(whole, z[:seam], elapsed[:seam])
    known = z[np.isfinite(z)]
    later.set_history(History(float(known[0]), begin, begin, float(elapsed[1:begin].sum()), *_between(z[:begin])))
    pushed(later, z[begin:seam], elapsed[begin:seam])
    stood, stands = whole.comparable_state(), later.comparable_state()
    one, other = pushed(whole, z[seam:], elapsed[seam:]), pushed(later, z[seam:], elapsed[seam:])
    if stood is not None and stands is not None and same_state(stood, stands, alive=later.surely_alive):
        assert same(one, other)


@pytest.mark.parametrize("name", CHANNELS)
def test_after_long_enough_they_do_stand_alike(name: str) -> None:
    z, elapsed = readings(5, 6 * CUT)
    z[5 * CUT - 500 : 5 * CUT] = np.random.default_rng(1).normal(size=500)  # nothing odd about the seam
    whole, later = open_channel(CHANNELS[name], STEP_S, 0), open_channel(CHANNELS[name], STEP_S, 0)
    seam, begin = 5 * CUT, 2 * CUT
    pushed(whole, z[:seam], elapsed[:seam])
    later.set_history(History(float(z[np.isfinite(z)][0]), begin, begin, float(begin), *_between(z[:begin])))
    pushed(later, z[begin:seam], elapsed[begin:seam])
    stood, stands = whole.comparable_state(), later.comparable_state()
    assert stood is not None
    assert stands is not None
    assert [one for one in stood if not np.array_equal(stood[one], stands[one], equal_nan=True)] in ([], [HOPS])


def test_a_channel_that_may_be_dead_is_not_surely_alive() -> None:
    rng, channel = np.random.default_rng(2), open_channel(CHANNELS["gated, watched"], STEP_S, 0)
    z = rng.normal(size=4 * CUT)
    pushed(channel, z[:CUT], np.ones(CUT))
    assert channel.surely_alive
    pushed(channel, 0.01 * z[CUT:], np.ones(3 * CUT))
    assert not channel.surely_alive


def test_a_filter_is_cut_while_its_readings_do_not_tell_a_slope_yet() -> None:
    z = np.full(CUT, np.nan)
    z[10], z[CUT // 2 :] = 1.0, np.arange(CUT // 2)
    whole, other = open_channel(CHANNELS["slope"], STEP_S, 0), open_channel(CHANNELS["slope"], STEP_S, 0)
    whole.push(z[: CUT // 2], np.ones(CUT // 2))
    held = whole.state_dict()
    assert held is not None
    other.load_state_dict(held)
    assert same(pushed(whole, z[CUT // 2 :], np.ones(CUT // 2)), pushed(other, z[CUT // 2 :], np.ones(CUT // 2)))


def test_a_smoother_cannot_be_cut_so() -> None:
    channel = open_channel(CHANNELS["level"], STEP_S, None)
    channel.push(np.random.default_rng(3).normal(size=CUT), np.ones(CUT))
    assert channel.state_dict() is None


def _between(z: Floats) -> tuple[float, float]:
    return float(np.nanmin(z, initial=np.inf)), float(np.nanmax(z, initial=-np.inf))


@pytest.mark.parametrize("lag", [0, 5, None])
@pytest.mark.parametrize("name", CHANNELS)
def test_steps_that_no_clock_gives_are_counted_alike(name: str, lag: int | None) -> None:
    """One where they are no number, none below 0, and at most 2^31."""
    z, odd, usual = np.random.default_rng(3).normal(size=400), np.ones(400), np.ones(400)
    odd[[0, 100, 200, 300]] = np.nan, np.nan, -3.0, np.inf
    usual[[200, 300]] = 0.0, float(1 << 31)
    told = []
    for elapsed in (odd, usual):
        channel = open_channel(CHANNELS[name], STEP_S, lag)
        told.append([*channel.push(z, elapsed), *channel.finish()])
    for one, other in zip(*told, strict=True):
        assert same(one, other)
