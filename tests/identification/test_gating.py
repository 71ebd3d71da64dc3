"""Whether a gate is worth having: spikes are of another kind than what heavy tails or motion bring."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Booleans, Floats
from becalm.core.filter.gate import Gate, threshold_for
from becalm.identification.choose import choose
from becalm.identification.gating import choose_gated, predicts_better
from becalm.identification.imputation import imputed
from becalm.identification.likelihood import Tuning

ROWS = 6000
GATE = Gate(threshold_for(1.0, 500.0))
ELAPSED = np.ones(ROWS)


def walk(seed: int) -> Floats:
    rng = np.random.default_rng(seed)
    return np.cumsum(0.05 * rng.normal(size=ROWS)) + rng.normal(size=ROWS)


def spikes(seed: int, share: float, size: float) -> Floats:
    rng = np.random.default_rng(seed + 50)
    return np.where(rng.random(ROWS) < share, size * rng.choice([-1.0, 1.0], ROWS), 0.0)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("share", "size"), [(0.01, 8.0), (0.03, 8.0), (0.01, 50.0), (0.03, 50.0), (0.001, 1e4)])
def test_spikes_do_not_inflate_the_noise(share: float, size: float, seed: int) -> None:
    clean = choose(walk(seed), ELAPSED).tuning
    found = choose_gated(walk(seed) + spikes(seed, share, size), ELAPSED, GATE)
    assert found.gated
    assert clean is not None
    assert found.choice.tuning is not None
    assert found.choice.tuning.noise_variance == pytest.approx(clean.noise_variance, rel=0.06)


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_without_spikes_the_choice_is_that_without_a_gate(seed: int, causal: bool) -> None:
    assert choose_gated(walk(seed), ELAPSED, GATE, causal) == (choose(walk(seed), ELAPSED, causal), True)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["jumps", "heavy steps", "heavy noise", "bursts"])
def test_what_is_motion_or_a_heavy_tail_keeps_the_choice_without_a_gate(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    z = {
        "jumps": np.cumsum(np.where(rng.random(ROWS) < 0.03, rng.normal(0, 20, ROWS), 0)) + 0.3 * rng.normal(size=ROWS),
        "heavy steps": np.cumsum(rng.standard_t(2, size=ROWS)) + 0.3 * rng.normal(size=ROWS),
        "heavy noise": np.cumsum(0.05 * rng.normal(size=ROWS)) + rng.laplace(size=ROWS),
        "bursts": np.where(np.arange(ROWS) % 1000 < 60, 20.0, 1.0) * rng.normal(size=ROWS),
    }[kind]
    assert choose_gated(z, ELAPSED, GATE) == (choose(z, ELAPSED), False)


def shocks(seed: int) -> Floats:
    """Return a quick motion, driven by rare large steps that stay: what a spike is not."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=ROWS) + np.where(rng.random(ROWS) < 0.01, 15 * rng.choice([-1.0, 1.0], ROWS), 0.0)
    return np.cumsum(steps) + 0.5 * rng.normal(size=ROWS)


@pytest.mark.parametrize("seed", range(3))
def test_the_readings_after_them_tell_spikes_from_motion(seed: int) -> None:
    quick = Tuning(1, 4.0, 0.25, ROWS)
    calm = Tuning(1, 0.0025, 1.0, ROWS)
    assert not predicts_better(quick, shocks(seed), ELAPSED, GATE)
    assert predicts_better(calm, walk(seed) + spikes(seed, 0.01, 8.0), ELAPSED, GATE)


def test_what_stands_for_rejects_is_as_likely_as_they_were() -> None:
    truth, z = Tuning(1, 0.0025, 1.0, ROWS), walk(1)
    rejected: Booleans = np.random.default_rng(9).random(ROWS) < 0.2
    drawn = imputed(truth, z, ELAPSED, rejected)
    assert np.array_equal(drawn[~rejected], z[~rejected])
    rms = np.sqrt(np.mean((drawn - z)[rejected] ** 2))
    assert rms == pytest.approx(np.sqrt(2), rel=0.1)  # two draws from one distribution


@pytest.mark.parametrize("kind", ["constant", "few", "none", "no reading"])
def test_what_tells_nothing_gets_no_gate(kind: str) -> None:
    z = {"constant": np.full(100, 2.0), "few": np.arange(4.0), "none": np.empty(0), "no reading": np.full(50, np.nan)}
    assert not choose_gated(z[kind], np.ones(len(z[kind])), GATE).gated
