"""Outliers stand out of their neighbours; motion does not, however far a filter is from it."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Booleans, Floats
from becalm.identification.modes.banks import rejects_stand_out

ROWS = 4000


def rows_of(*places: int) -> Booleans:
    marked: Booleans = np.isin(np.arange(ROWS), places)
    return marked


@pytest.mark.parametrize("share", [0.001, 0.01, 0.05])
@pytest.mark.parametrize("size", [8.0, 50.0, 1e6])
def test_spikes_in_noise_and_in_pairs_stand_out(share: float, size: float) -> None:
    rng = np.random.default_rng(2)
    bad: Booleans = rng.random(ROWS) < share
    z = np.cumsum(0.1 * rng.normal(size=ROWS)) + rng.normal(size=ROWS) + np.where(bad, size, 0.0)
    assert rejects_stand_out(z, bad)
    pairs = bad | np.roll(bad, 1)
    assert rejects_stand_out(np.where(np.roll(bad, 1) & ~bad, z - size, z), pairs)


@pytest.mark.parametrize("kind", ["shock", "ringing"])
def test_motion_is_none(kind: str) -> None:
    rng, k = np.random.default_rng(3), np.arange(ROWS) - 2000.0
    truth: dict[str, Floats] = {
        "shock": np.where((k > 0) & (k < 40), 400 * np.sin(np.pi * k / 40), 0.0),
        "ringing": np.where(k > 0, 400 * np.exp(-np.maximum(k, 0) / 80) * np.sin(0.9 * k), 0.0),
    }
    z = truth[kind] + rng.normal(size=ROWS)
    places = {"shock": (2001, 2002, 2019, 2020, 2038), "ringing": tuple(range(2001, 2060))}
    assert not rejects_stand_out(z, rows_of(*places[kind]))


def test_readings_that_are_missing_or_too_few_tell_nothing() -> None:
    z = np.full(ROWS, np.nan)
    assert rejects_stand_out(z, rows_of(3, 4))  # nothing is rejected
    z[[5, 9]] = 1.0, 2.0
    assert not rejects_stand_out(z, rows_of(5, 9))


def test_the_first_reading_after_a_jump_stands_out_only_where_that_is_allowed() -> None:
    z = 0.1 * np.random.default_rng(4).normal(size=400)
    z[200:] += 20.0
    z[200] += 3.0
    first = np.arange(400) == 200
    assert not rejects_stand_out(z, first)
    assert rejects_stand_out(z, first, at_jumps=True)
    z[300] += 3.0
    assert rejects_stand_out(z, np.arange(400) == 300)
