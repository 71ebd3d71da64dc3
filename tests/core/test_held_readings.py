"""Readings that repeat the one before: told from rests of a coarse converter, and from values that are set."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.health.held_readings import repeats_readings
from becalm.core.health.limits import find_limits, find_resolution
from becalm.native.scans import EVERY_REPEAT

ROWS = 12000


def moving(seed: int = 0, rows: int = ROWS, digits: int = 3) -> Floats:
    """Return a slow motion in noise of 0.3, read to so many digits."""
    rng = np.random.default_rng(seed)
    return np.round(20 + 5 * np.sin(np.arange(rows) / 150) + 0.3 * rng.normal(size=rows), digits)


def dropouts(runs: int) -> Floats:
    """Return a record with so many stretches of 30 rows that repeat the last reading."""
    rng, z = np.random.default_rng(1), moving()
    for start in rng.choice(np.arange(100, ROWS - 100, 100), runs, replace=False):
        z[start + 1 : start + 30] = z[start]
    return z


def repeated_at_random(z: Floats, share: float) -> Floats:
    new = np.append(True, np.random.default_rng(2).random(len(z) - 1) >= share)
    return z[np.maximum.accumulate(np.where(new, np.arange(len(z)), 0))]


def is_held(z: Floats) -> bool:
    return repeats_readings(z, find_resolution(z))


HELD = {
    **{f"every value {count} times": np.repeat(moving(rows=ROWS // count), count) for count in (2, 4, 10, 100)},
    "every value 500 times": np.repeat(moving(rows=100), 500),
    "72 % repeats": repeated_at_random(moving(), 0.72),
    "72 % repeats at rest": repeated_at_random(np.round(0.3 * np.random.default_rng(3).normal(size=ROWS), 3), 0.72),
    "40 dropouts": dropouts(40),
    "50 dropouts": dropouts(50),
    "100 dropouts": dropouts(100),
    "ten codes of noise": np.repeat(moving(digits=1)[: ROWS // 4], 4)[:ROWS],
}


@pytest.mark.parametrize("name", HELD)
def test_repeats_of_a_noisy_sensor_are_held(name: str) -> None:
    z = HELD[name]
    assert is_held(z)
    assert find_limits(z, np.ones(len(z)), 1.0, 0.01).stuck_readings == EVERY_REPEAT


def steps(seed: int, dwell: int) -> Floats:
    """Return ten levels, each held for about so long, without noise."""
    rng = np.random.default_rng(seed)
    levels = np.repeat(rng.integers(0, 10, 400), rng.integers(dwell // 2, 2 * dwell, 400))
    return np.asarray(5.0 * levels[:ROWS], np.float64)


NOT_HELD = {
    "noise": moving(),
    "coarse at rest": np.round(0.3 * np.random.default_rng(4).normal(size=ROWS)),
    "a fifth of a code": np.round(0.2 * np.random.default_rng(4).normal(size=ROWS) + 0.4),
    "two codes": np.round(2 * np.random.default_rng(5).normal(size=ROWS)),
    "five codes": np.round(5 * np.random.default_rng(6).normal(size=ROWS)),
    "a slow temperature": np.round(20 + np.sin(np.arange(ROWS) / 2000), 2),
    "a slow temperature in noise": np.round(20 + np.sin(np.arange(ROWS) / 2000) + 0.004 * moving(7), 2),
    "stairs": np.floor(np.arange(ROWS) / 300.0),
    "set values": steps(8, 60),
    "a switch": np.sign(np.sin(np.arange(ROWS) / 70)),
    "a car that stops": np.round(np.maximum(0, 30 * np.sin(np.arange(ROWS) / 350) + 0.1 * moving(9)), 2),
    "an encoder that rests and moves": np.round(500 * np.clip(np.sin(np.arange(ROWS) / 400), -0.6, 0.6)),
    "rest, then shaking": np.round(
        np.where(np.arange(ROWS) < 6000, 0.2, 40.0) * np.random.default_rng(9).normal(size=ROWS)
    ),
    "eight dropouts, faults of the sensor": dropouts(8),
    "a constant": np.full(ROWS, 3.0),
    "nothing": np.empty(0),
}


@pytest.mark.parametrize("name", NOT_HELD)
def test_rests_and_set_values_are_not_held(name: str) -> None:
    assert not is_held(NOT_HELD[name])
