"""Drivers' stamps give back the grid behind them; samples that were irregular, or lost, are left alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.time.even_grid import BURSTS, JITTER, Grid, even_grid

SEEDS = 200

Sampled = Callable[[np.random.Generator], Floats]
Defect = Callable[[Floats, np.random.Generator], Floats]


def found(stamps: Floats, block: int = 700) -> Grid | None:
    return even_grid(len(stamps), lambda: (stamps[at : at + block] for at in range(0, len(stamps), block)))


def even(rng: np.random.Generator) -> Floats:
    """True times of a drifted clock, at any rate and from any start."""
    rate = rng.choice([20.0, 100.0, 200.0, 1000.0]) * (1.0 + rng.normal(0.0, 1e-3))
    return np.asarray(rng.uniform(0.0, 100.0) + np.arange(rng.integers(1500, 6000)) / rate)


def jittered(true: Floats, rng: np.random.Generator) -> Floats:
    return np.sort(true + rng.normal(0.0, rng.uniform(0.03, 0.1), len(true)) * (true[1] - true[0]))


def delayed(true: Floats, rng: np.random.Generator) -> Floats:
    """An operating system hands over each sample a little later."""
    return np.sort(true + rng.exponential(rng.uniform(0.03, 0.05) * (true[1] - true[0]), len(true)))


def polled(true: Floats, rng: np.random.Generator) -> Floats:
    """A driver looks every few steps, and stamps what it finds."""
    step = true[1] - true[0]
    every = rng.uniform(2.2, 9.0)
    looks = true[0] + step * every * (np.arange(len(true) / every + 3.0) + rng.uniform())
    looks += rng.exponential(0.05 * step, len(looks))
    look = np.searchsorted(looks, true)
    within = np.arange(len(true)) - np.searchsorted(look, look)
    return np.maximum.accumulate(looks[look] + within * step * rng.choice([0.0, 0.005]))


def equal(true: Floats, rng: np.random.Generator) -> Floats:
    """A driver waits for about so many samples, and stamps them all at once."""
    sizes = rng.integers(2, 7) + rng.integers(0, 3, len(true))
    burst = np.searchsorted(np.cumsum(sizes), np.arange(len(true)), side="right")
    last = np.minimum(np.cumsum(sizes)[burst] - 1, len(true) - 1)
    late = rng.exponential(0.1 * (true[1] - true[0]), len(true))
    return np.asarray(true[last] + late[burst])


@pytest.mark.parametrize(("defect", "kind"), [(jittered, JITTER), (delayed, JITTER), (polled, BURSTS), (equal, BURSTS)])
def test_times_come_back_within_a_tenth_of_a_step(defect: Defect, kind: str) -> None:
    mended = 0
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        true = even(rng)
        grid = found(defect(true, rng))
        if grid is not None:
            assert grid.kind == kind
            times = grid.start_s + grid.step_s * np.arange(len(true))
            assert np.abs(times - true).max() < 0.1 * grid.step_s, seed
            mended += 1
    assert mended >= 0.95 * SEEDS  # the others are left as they came, which is no mistake


def events(rng: np.random.Generator) -> Floats:
    causes = np.cumsum(rng.exponential(5.0, 500))
    return np.sort(np.concatenate([causes + rng.exponential(0.3, 500) for _ in range(4)]))


def one_row_lost(rng: np.random.Generator) -> Floats:
    stamps = jittered(even(rng), rng)
    return np.delete(stamps, rng.integers(5, len(stamps) - 5))


def one_row_of_bursts_lost(rng: np.random.Generator) -> Floats:
    stamps = polled(even(rng), rng)
    return np.delete(stamps, rng.integers(len(stamps) // 5, 4 * len(stamps) // 5))


def some_rows_lost(rng: np.random.Generator) -> Floats:
    stamps = jittered(even(rng), rng)
    return np.delete(stamps, rng.integers(0, len(stamps), len(stamps) // 50))


def another_rate(rng: np.random.Generator) -> Floats:
    half = 1000
    steps = np.repeat([1.0, 1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.01, 0.5)], half)
    return np.asarray(np.cumsum(steps) + rng.normal(0.0, 0.05, 2 * half))


def a_gap(rng: np.random.Generator) -> Floats:
    stamps = polled(even(rng), rng)
    stamps[len(stamps) // 2 :] += 30.0 * np.median(np.diff(stamps)) + 0.5
    return stamps


def periodic_drop_outs(rng: np.random.Generator) -> Floats:
    """Even samples, of which a radio loses most, again and again."""
    rows, period = np.arange(60_000.0), 300.7
    kept = rows[(rows + rng.uniform(0.0, period)) % period < 20.3]
    return np.sort(kept + rng.normal(0.0, rng.choice([0.005, 0.03, 0.1, 0.2]), len(kept)))


def drop_outs(rng: np.random.Generator) -> Floats:
    """Even samples, of which any share is kept, in stretches of any length."""
    share, length = 10 ** rng.uniform(-2.0, -0.4), rng.uniform(1.6, 60.0)
    rows, period = np.arange(max(60_000.0, length / share * rng.integers(150, 400))), length / share
    kept = rows[(rows + rng.uniform(0.0, period)) % period < length]
    return np.sort(kept + rng.normal(0.0, rng.uniform(0.01, 0.15), len(kept)))


def random_drop_outs(rng: np.random.Generator) -> Floats:
    rows = np.arange(6000.0)[rng.uniform(size=6000) < rng.uniform(0.05, 0.95)]
    return np.sort(rows + rng.normal(0.0, rng.uniform(0.03, 0.1), len(rows)))


def duty_cycle(rng: np.random.Generator) -> Floats:
    """A logger that wakes, reads some samples quickly, and sleeps."""
    return np.asarray((np.arange(500.0)[:, None] + np.arange(rng.integers(2, 9)) * 0.02).ravel())


def sensors_in_turn(rng: np.random.Generator) -> Floats:
    """A table with a row for each of some sensors at every time."""
    return np.repeat(np.arange(1000) + rng.normal(0.0, 0.01, 1000), rng.integers(2, 6))


def whole_seconds(rng: np.random.Generator) -> Floats:
    """Stamps cut to seconds come before their samples, not after."""
    return np.floor(np.arange(3000) / rng.uniform(5.0, 30.0))


IRREGULAR: dict[str, Sampled] = {
    "random": lambda rng: np.cumsum(rng.exponential(1.0, 3000)),
    "uneven steps": lambda rng: np.cumsum(rng.gamma(rng.uniform(2.0, 400.0), 1.0, 3000)),
    "one at random in each step": lambda rng: np.arange(3000) + rng.uniform(0.0, 1.0, 3000),
    "two rates at once": lambda rng: np.sort(
        np.concatenate([np.arange(999.0), np.arange(999.0) * rng.uniform(1.1, 3.0)])
    ),
    "a pattern of steps": lambda rng: np.cumsum(np.tile(rng.integers(1, 4, 7).astype(float), 300)),
    "slow drift": lambda rng: np.arange(3000) + 3.0 * np.sin(np.arange(3000) / 500.0 + rng.uniform(0.0, 6.0)),
    "events": events,
    "one row lost": one_row_lost,
    "one row of bursts lost": one_row_of_bursts_lost,
    "rows lost": some_rows_lost,
    "another rate": another_rate,
    "a gap": a_gap,
    "periodic drop-outs": periodic_drop_outs,
    "drop-outs": drop_outs,
    "random drop-outs": random_drop_outs,
    "duty cycle": duty_cycle,
    "sensors in turn": sensors_in_turn,
    "whole seconds": whole_seconds,
}


@pytest.mark.parametrize("sampled", IRREGULAR.values(), ids=IRREGULAR.keys())
def test_what_is_irregular_or_lost_is_left_alone(sampled: Sampled) -> None:
    mended = [seed for seed in range(SEEDS) if found(sampled(np.random.default_rng(seed)))]
    assert not mended


@pytest.mark.parametrize("block", [1, 97, 5000])
@pytest.mark.parametrize("defect", [jittered, polled])
def test_blocks_do_not_matter(block: int, defect: Defect) -> None:
    rng = np.random.default_rng(4)
    stamps = defect(even(rng), rng)
    whole, parts = found(stamps, len(stamps)), found(stamps, block)
    assert whole is not None
    assert parts is not None
    np.testing.assert_allclose(parts[1:], whole[1:], rtol=1e-4)


def test_what_is_no_time_has_no_grid() -> None:
    stamps = jittered(even(np.random.default_rng(1)), np.random.default_rng(2))
    fallen, missing = stamps.copy(), stamps.copy()
    fallen[300], missing[300] = fallen[298] - 1.0, np.nan
    for wrong in (fallen, missing, np.full(500, 3.0), stamps[:50]):
        assert found(wrong) is None
