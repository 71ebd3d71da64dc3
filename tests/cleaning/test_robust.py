"""A robust recipe: what is wild may be as large as it likes."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.cleaning.pipeline import clean
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats
from becalm.core.recording import Recording

ROWS, STARTING = 4000, 300


def sine(seed: int, size: float, *, first: bool = False) -> tuple[Floats, Floats]:
    """Return a sine, and readings of it of which 2 % are wild, all equally large; perhaps the first one too."""
    rng = np.random.default_rng(seed)
    truth = np.sin(np.pi * np.arange(ROWS) / 100)
    z, wild = truth + 0.1 * rng.normal(size=ROWS), rng.random(ROWS) < 0.02
    wild[0] = first
    return truth, np.where(wild, size * rng.choice([-1.0, 1.0], ROWS), z)


def error(seed: int, size: float, causal: bool, *, first: bool = False) -> float:
    truth, z = sine(seed, size, first=first)
    recording = Recording(z, rate_hz=100.0)
    recipe = tune(recording, causal=causal, wishes=Wishes(robust=True))
    off = clean(recording, recipe).signal.samples[:, 0] - truth
    return float(np.sqrt(np.mean(off[STARTING:] ** 2)))


@pytest.mark.parametrize(("causal", "first"), [(True, True), (False, False)])
def test_wild_readings_of_a_thousand_cost_no_more_than_those_of_ten(causal: bool, first: bool) -> None:
    """Of noise 0.1: the error stays below a half of it, though the wild ones are 10 000 times as large."""
    assert error(0, 1e3, causal, first=first) < 0.05
    assert error(0, 10.0, causal, first=first) < 0.05


@pytest.mark.parametrize("size", [2.0, 2.5])
def test_a_robust_recipe_tells_the_size_of_what_is_wild(size: float) -> None:
    """Of what is no gross outlier, which goes before any filter."""
    _, z = sine(1, size)
    (channel,) = tune(Recording(z, rate_hz=100.0), wishes=Wishes(robust=True)).channel
    assert channel.switching is not None
    assert abs(np.log(channel.switching.wild_std / size)) < 0.5  # a search of few strides
    assert channel.switching.mode[0].noise_std == pytest.approx(0.1, rel=0.1)
