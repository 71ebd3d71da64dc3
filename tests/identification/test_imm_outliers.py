"""A robust filter: as good as the one that is chosen where nothing is wild."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Booleans, Floats
from becalm.core.imm.flow import ImmFlow
from becalm.core.imm.modes import InteractingModels, Mode
from becalm.core.model.components import motion, oscillator, with_walking_level
from becalm.errors import ModelError
from becalm.identification.choose import choose
from becalm.identification.likelihood import Evidence
from becalm.identification.modes import banks
from becalm.identification.modes.banks import find_outliers
from becalm.identification.modes.switching import choose_robust, robust_filter

ROWS, STARTING = 8000, 500


def record(name: str, seed: int) -> tuple[Floats, Floats, Booleans]:
    """Return a signal, good readings of it, and which of them shall be wild."""
    rng = np.random.default_rng([seed, 5])
    truth = {
        "random walk": np.cumsum(0.03 * rng.normal(size=ROWS)),
        "slow sine": 5 * np.sin(np.pi * np.arange(ROWS) / 500),
        "constant": np.full(ROWS, 3.0),
    }[name]
    return truth, truth + rng.normal(size=ROWS), rng.random(ROWS) < 0.1


def robust_error(z: Floats, truth: Floats, causal: bool) -> float:
    elapsed = np.ones(ROWS)
    tuning = choose(z, elapsed, causal).tuning
    assert tuning is not None
    flow = ImmFlow(choose_robust(tuning, Evidence.of(z, elapsed), causal).switching, causal=causal)
    signal = np.concatenate([told.signal for told in [*flow.push(z, elapsed), *flow.finish()]])
    return float(np.sqrt(np.mean((signal - truth)[STARTING:] ** 2)))


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize(("seed", "name"), [(0, "random walk"), (1, "slow sine"), (2, "constant")])
def test_one_in_ten_of_8_sigma_costs_little(seed: int, name: str, causal: bool) -> None:
    """Up to 1.5 times the error without them."""
    truth, good, wild = record(name, seed)
    z = good + 8 * wild * np.random.default_rng(seed).choice([-1.0, 1.0], ROWS)
    assert robust_error(z, truth, causal) < 1.5 * robust_error(good, truth, causal)


def test_wild_readings_are_told_from_tame_ones() -> None:
    _, good, wild = record("random walk", 1)
    z, elapsed = good + 12 * wild, np.ones(ROWS)
    z[100] = np.nan
    wild[100] = False
    tuning = choose(z, elapsed, True).tuning
    assert tuning is not None
    told = find_outliers(robust_filter(tuning, Evidence.of(z, elapsed)).switching, z, elapsed)
    assert np.mean(told[STARTING:] == wild[STARTING:]) > 0.98
    assert told[wild][STARTING:].all()
    assert not told[100]


def test_a_jump_moves_the_level_and_leaves_the_tone() -> None:
    """The abrupt mode is the steady one but for the level, so that slope and tone go on."""
    truth, good, wild = record("slow sine", 2)
    z = good + 8 * wild
    z[4000:] += 50.0
    elapsed = np.ones(ROWS)
    tuning = choose(good, elapsed, True).tuning
    assert tuning is not None
    switching = robust_filter(tuning, Evidence.of(z, elapsed)).switching
    signal = ImmFlow(switching, causal=True).push(z, elapsed)[0].signal
    assert np.abs(signal - truth - 50)[4015:4100].max() < 3.0
    assert np.abs(signal - truth)[3900:4000].max() < 3.0


def test_a_walking_level_adds_to_the_level_alone() -> None:
    steps = np.array([0.0, 1.0, 2.5])
    for part in (motion(1, 0.3), motion(3, 0.3), motion(2, 0.3) + oscillator(0.1, 0.0, 0.2)):
        F, Q = part.over(steps)
        wider_F, wider_Q = with_walking_level(part, 7.0).over(steps)
        gained = np.zeros_like(Q)
        gained[:, 0, 0] = 7.0 * steps
        np.testing.assert_allclose(wider_F, F, rtol=1e-12)
        np.testing.assert_allclose(wider_Q - Q, gained, rtol=1e-12, atol=1e-12)
    with pytest.raises(ModelError, match="density"):
        with_walking_level(motion(1), -1.0)


def test_from_minus_infinity_to_minus_infinity_is_no_gain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no number explains the readings, as float64 counts, each stays where it began."""
    monkeypatch.setattr(banks, "log_likelihood", lambda switching, pieces: -np.inf)
    one, made = Mode("one", motion(1, 1.0), 1.0, 1.0), list[float]()

    def make(r: float) -> InteractingModels:
        made.append(r)
        return InteractingModels((one,))

    banks.search_imm(banks.ImmFamily([banks.Parameter(1.0, 1e-4, 1e4)], make), [])
    assert made[-1] == 1.0
