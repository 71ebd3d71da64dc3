"""Readings that are far out do not tune anything."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.noise.far import running_median, without_far


def noise(count: int = 4000) -> Floats:
    return np.random.default_rng(2).normal(size=count)


def test_the_running_median_is_that_of_five() -> None:
    z = noise(200)
    found = running_median(z)
    assert found[2:-2].tolist() == [np.median(z[k - 2 : k + 3]) for k in range(2, 198)]
    assert found[0] == found[1] == np.median(z[:5])
    assert found[-1] == np.median(z[-5:])


def test_pieces_make_no_difference() -> None:
    z = noise(200_000)
    assert np.array_equal(running_median(z)[65_000:67_000], running_median(z[64_990:67_010])[10:-10])


@pytest.mark.parametrize("row", [0, 1, 2000, 3998, 3999])
@pytest.mark.parametrize("size", [1e4, -1e8])
def test_a_reading_far_out_is_replaced_and_no_other(row: int, size: float) -> None:
    z = noise()
    z[row] = size
    tame = without_far(z)
    assert np.flatnonzero(tame != z).tolist() == [row]
    assert abs(tame[row]) < 3.0
    assert z[row] == size


def test_missing_readings_stay_missing() -> None:
    z = noise()
    z[100:110], z[50] = np.nan, 1e6
    tame = without_far(z)
    assert np.array_equal(np.isnan(tame), np.isnan(z))
    assert abs(tame[50]) < 3.0


@pytest.mark.parametrize(
    "z",
    [
        noise() + 8 * np.random.default_rng(3).choice([-1.0, 1.0], 4000),
        np.cumsum(np.cumsum(noise())),
        np.where(np.arange(4000) < 2000, 0.0, 1e6) + noise(),
        np.round(0.1 * noise()),
        np.zeros(4000),
        np.where(np.arange(4000) % 3 == 0, 1e6, 0.0) + noise(),
        np.full(4000, np.nan),
        np.array([0.0, 1e9, 0.0]),
    ],
    ids=["spikes", "motion", "jump", "coarse", "zeros", "every third", "nothing", "three"],
)
def test_what_is_not_far_out_comes_back_as_it_is(z: Floats) -> None:
    assert without_far(z) is z


def test_motion_that_runs_away_at_the_ends_is_not_far_out() -> None:
    """Its neighbours lead there from one side only."""
    t = np.arange(4000.0)
    z = 1e-4 * t**3 + np.random.default_rng(1).normal(size=4000)
    assert np.array_equal(without_far(z), z)
    for row in (0, 1, 3998, 3999):
        spoilt = z.copy()
        spoilt[row] += 1e9
        tame = without_far(spoilt)
        assert np.flatnonzero(tame != spoilt).tolist() == [row]
