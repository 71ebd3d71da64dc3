"""The damping of a motion: by it the model's spread is the record's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import becalm
from becalm.core.arrays import Floats
from becalm.core.model.components import LEVEL_RATE
from becalm.identification.choose import choose
from becalm.identification.damping import damped, spread_about_level
from becalm.identification.likelihood import Evidence, Tuning


def band_noise(rng: np.random.Generator, count: int, highest: float) -> Floats:
    """Return noise of unit variance below a frequency, in cycles a step."""
    spectrum = np.fft.rfft(rng.normal(size=count))
    spectrum[np.fft.rfftfreq(count) > highest] = 0
    x = np.fft.irfft(spectrum, count)
    return np.asarray(x / x.std())


@pytest.mark.parametrize("highest", [0.01, 0.15])
def test_a_motion_has_the_spread_of_its_record(highest: float) -> None:
    rng = np.random.default_rng(1)
    x = 7.0 + 3.0 * band_noise(rng, 8000, highest)
    z = x + 0.1 * rng.normal(size=8000)
    found = choose(z, np.ones(8000), causal=False).tuning
    assert found is not None
    assert found.damping > 0
    n, q = found.order, found.ratio * found.noise_variance
    own = q / (2 * n * np.sin(np.pi / (2 * n)) * found.damping ** (2 * n - 1))
    assert own == pytest.approx(spread_about_level(z, LEVEL_RATE * found.damping) - found.noise_variance, rel=0.05)
    assert 0.7 * 9.0 < own < 1.1 * 9.0


def test_a_walk_that_does_not_return_stays_a_walk() -> None:
    rng = np.random.default_rng(2)
    z = np.cumsum(rng.normal(size=4000)) + rng.normal(size=4000)
    found = choose(z, np.ones(4000), causal=False).tuning
    assert found is not None
    assert found.order == 1
    assert found.damping < 0.01


def test_what_does_not_move_is_not_damped() -> None:
    evidence = Evidence.of(np.random.default_rng(3).normal(size=100), np.ones(100))
    still = Tuning(2, 0.0, 1.0, 97)
    assert damped(still, evidence) is still


def test_a_spread_is_told_about_a_level_that_follows() -> None:
    z = np.repeat([0.0, 100.0], 500) + np.tile([1.0, -1.0], 500)
    assert spread_about_level(z, 0.0) == pytest.approx(50.0**2 + 1, rel=1e-6)
    assert spread_about_level(z, 0.5) < 50.0


@pytest.mark.parametrize(
    ("highest", "gap", "causal"), [(0.15, 40, False), (0.15, 40, True), (0.15, 200, False), (0.05, 200, True)]
)
def test_a_gap_is_never_worse_than_the_record(highest: float, gap: int, causal: bool) -> None:
    rng = np.random.default_rng(gap)
    x = band_noise(rng, 8000, highest)
    z = x + 0.02 * rng.normal(size=8000)
    hole = slice(4000, 4000 + gap)
    z[hole] = np.nan
    recording = becalm.Recording(z, rate_hz=200.0)
    recipe = becalm.tune(recording, causal=causal, wishes=becalm.Wishes(fill=True))
    filled = becalm.clean(recording, recipe).signal.samples[hole, 0]
    assert np.abs(filled).max() <= np.nanmax(np.abs(z))
    (channel,) = recipe.channel
    out = becalm.clean(recording, recipe.model_copy(update={"channel": (channel.model_copy(update={"fill": False}),)}))
    told = np.isfinite(out.signal.samples[hole, 0])
    assert told.any()
    assert out.sigma.samples[hole, 0][told].max() < 2.5


@settings(max_examples=25, deadline=None)
@given(
    order=st.integers(1, 5),
    ratio=st.floats(-8, 2),
    scale=st.floats(-6, 6),
    seed=st.integers(0, 1000),
    count=st.integers(8, 400),
)
def test_any_record_gives_a_damping_that_makes_a_filter(
    order: int, ratio: float, scale: float, seed: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    z = 10.0**scale * np.cumsum(rng.normal(size=count))
    tuning = Tuning(order, 10.0**ratio, float(np.var(z)) * 1e-2 + 1e-300, count)
    found = damped(tuning, Evidence.of(z, np.ones(count)))
    assert replace(found, damping=0.0) == tuning
    assert 0 <= found.damping <= np.pi / 4
    F, Q = found.component.over(np.array([1.0, 1e3]))
    assert np.isfinite(F).all()
    assert np.isfinite(Q).all()


@pytest.mark.parametrize("seed", [1, 5])
def test_what_returns_in_no_record_is_not_damped(seed: int) -> None:
    """A clamped wave, of which a damping of 1e-14 cycles a step was found, and refused."""
    noise = 0.05 * np.random.default_rng(seed).normal(size=4000)
    z = np.maximum(5 + 6 * np.sin(1.3 * np.arange(4000)) + noise, 0)
    out = becalm.clean(becalm.Recording(z, rate_hz=100.0), causal=True)
    assert np.abs(out.signal.samples).max() < 12
