"""Modes that a recording shows: found where they are, and not where they are not."""

from __future__ import annotations

import numpy as np
import pytest

import becalm
from becalm.core.arrays import Booleans, Floats
from becalm.core.imm.flow import ImmFlow
from becalm.identification.choose import choose
from becalm.identification.likelihood import Evidence
from becalm.identification.modes.banks import middle_variance, quiet_variance
from becalm.identification.modes.switching import IdentifiedImm, find_large_change, find_switching, robust_filter

COUNT = 8000


def noise(seed: int, std: float = 1.0, count: int = COUNT) -> Floats:
    return np.random.default_rng(seed).normal(0.0, std, count)


def levels(seed: int, height: float = 5.0, hold: int = 800) -> Floats:
    return np.repeat(height * np.random.default_rng(seed).normal(size=COUNT // hold), hold)


def rests_and_motion(seed: int) -> tuple[Floats, Booleans]:
    """Return a signal that rests every other thousand rows, and where it moves."""
    moves = (np.arange(COUNT) // 1000) % 2 == 1
    velocity = np.cumsum(noise(seed, 0.02) * moves)
    signal = np.cumsum(velocity * moves)
    return signal, moves


def found(z: Floats, causal: bool = True) -> IdentifiedImm | None:
    elapsed = np.ones(len(z))
    tuning = choose(z, elapsed, causal).tuning
    assert tuning is not None
    return find_switching(tuning, Evidence.of(z, elapsed), causal)


def filtered(switched: IdentifiedImm, z: Floats, causal: bool = True) -> Floats:
    flow = ImmFlow(switched.switching, causal=causal)
    return np.concatenate([told.signal for told in [*flow.push(z, np.ones(len(z))), *flow.finish()]])


def error(signal: Floats, truth: Floats) -> float:
    return float(np.sqrt(np.mean((signal - truth) ** 2)))


@pytest.mark.parametrize("seed", range(5))
def test_nothing_surprises_in_noise_motion_and_tones(seed: int) -> None:
    z = noise(seed)
    assert find_large_change(z) is None
    assert find_large_change(np.cumsum(z)) is None
    assert find_large_change(5 * np.sin(0.02 * np.arange(COUNT)) + z) is None


@pytest.mark.parametrize("height", [0.5, 2.0, 50.0])
def test_a_jump_surprises_where_it_is(height: float) -> None:
    z = noise(1)
    z[5000:] += height
    row = find_large_change(z)
    assert row is not None
    assert abs(row - 5000) < 40 / min(height, 1) ** 2 * 8


def test_levels_that_jump_are_followed_at_once() -> None:
    truth = levels(1)
    z = truth + noise(2)
    switched = found(z)
    assert switched is not None
    assert switched.kind == "jumping"
    assert switched.log_likelihood > switched.fixed_log_likelihood + 100
    r = [mode.noise_variance for mode in switched.switching.modes]
    assert r == pytest.approx([1.0] * len(r), rel=0.06)
    assert error(filtered(switched, z), truth) < 0.25


@pytest.mark.parametrize(("hold", "causal"), [(150, False), (150, True), (1500, False)])
def test_levels_without_noise_are_followed_as_they_are(hold: int, causal: bool) -> None:
    z = (np.arange(3000) // hold % 2).astype(float)
    cleaned = becalm.clean(becalm.Recording(z[:, np.newaxis], rate_hz=100.0), causal=causal)
    np.testing.assert_allclose(cleaned.signal.samples[:, 0], z, atol=1e-2)


def test_a_smoother_of_levels_errs_less_than_the_fixed_one() -> None:
    truth = levels(3)
    z = truth + noise(4)
    switched, elapsed = found(z, causal=False), np.ones(COUNT)
    assert switched is not None
    choice = choose(z, elapsed, False).tuning
    assert choice is not None
    fixed = becalm.kalman_smoother(choice.component.to_model(1.0, choice.noise_variance), z).signal[:, 0]
    assert error(filtered(switched, z, causal=False), truth) < 0.5 * error(fixed, truth)


@pytest.mark.parametrize("seed", range(2))
def test_rest_between_motions_is_found(seed: int) -> None:
    signal, moves = rests_and_motion(seed)
    z = signal + noise(seed + 10, 0.3)
    switched = found(z)
    assert switched is not None
    tuning = choose(z, np.ones(COUNT), True).tuning
    assert tuning is not None
    fixed = becalm.kalman_filter(tuning.component.to_model(1.0, tuning.noise_variance), z).signal[:, 0]
    own, rest = filtered(switched, z), ~moves & (np.arange(COUNT) % 1000 > 300)
    assert error(own[rest], signal[rest]) < 0.5 * error(fixed[rest], signal[rest])
    assert error(own[moves], signal[moves]) < 1.1 * error(fixed[moves], signal[moves])


@pytest.mark.parametrize("seed", range(3))
def test_nothing_switches_in_what_a_fixed_filter_describes(seed: int) -> None:
    z = noise(seed)
    for record in (z, np.cumsum(noise(seed + 20, 0.1)) + z, 5 * np.sin(0.05 * np.arange(COUNT)) + z):
        assert found(record) is None


def test_noise_that_changes_is_told_from_motion() -> None:
    loud = (np.arange(COUNT) // 2000) % 2 == 1
    truth = np.cumsum(noise(5, 0.05))
    z = truth + noise(6) * np.where(loud, 4.0, 1.0)
    switched = found(z)
    assert switched is not None
    assert switched.kind == "noisy"
    quiet, other = (np.sqrt(mode.noise_variance) for mode in switched.switching.modes)
    assert (quiet, other) == pytest.approx((1.0, 4.0), rel=0.1)
    flow = ImmFlow(switched.switching, causal=True, split=True)
    told = flow.push(z, np.ones(COUNT))[0]
    assert np.mean((told.parts[-1] > 0.5) == loud) > 0.98


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_wild_readings_are_left_out(share: float) -> None:
    """8 sigma at 1 % within 1.1 of the error without them, at 10 % within 1.5; medians of three records."""
    ratios = []
    for seed in range(3):
        rng = np.random.default_rng([seed, 3])
        truth = np.cumsum(rng.normal(0, 0.05, COUNT))
        calm = truth + rng.normal(size=COUNT)
        z = calm + 8 * rng.choice([-1.0, 1.0], COUNT) * (rng.random(COUNT) < share)
        tuning = choose(calm, np.ones(COUNT), True).tuning
        assert tuning is not None
        evidence = Evidence.of(z, np.ones(COUNT))
        robust = robust_filter(choose(z, np.ones(COUNT), True).tuning or tuning, evidence)
        model = tuning.component.to_model(1.0, tuning.noise_variance)
        best = [run(model, calm).signal[:, 0] for run in (becalm.kalman_smoother, becalm.kalman_filter)]
        ratios.append([error(filtered(robust, z, bool(c)), truth) / error(best[c], truth) for c in range(2)])
    assert (np.median(ratios, axis=0) < (1.1 if share == 0.01 else 1.5)).all()


def test_a_robust_filter_follows_a_jump_of_50_sigma() -> None:
    """Within 15 readings: it has to tell it from wild ones that agree by chance."""
    rng = np.random.default_rng(8)
    z = rng.normal(size=COUNT) + 8 * rng.choice([-1.0, 1.0], COUNT) * (rng.random(COUNT) < 0.1)
    z[4000:] += 50
    tuning = choose(z, np.ones(COUNT), True).tuning
    assert tuning is not None
    own = filtered(robust_filter(tuning, Evidence.of(z, np.ones(COUNT))), z)
    assert np.all(np.abs(own[4015:4100] - 50) < 3)
    assert np.all(np.abs(own[3900:4000]) < 3)


def test_variances_of_quiet_and_of_most_readings() -> None:
    z = noise(9, 2.0)
    assert quiet_variance(z) == pytest.approx(4.0, rel=0.4)
    z[::10] += 100.0
    assert middle_variance(z) < 4 * 4.0
    assert quiet_variance(np.zeros(5)) == 0.0


def test_a_first_stretch_of_few_readings_does_not_decide() -> None:
    z = levels(3) + noise(4)
    z[3:10] = np.nan  # three readings, and then all the others
    switched = found(z, causal=False)
    assert switched is not None
    assert switched.kind == "jumping"
