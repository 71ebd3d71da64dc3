"""One reading that no sensor gives, anywhere in a recording: it is left out, and nothing is tuned by it."""

from __future__ import annotations

from functools import cache
from itertools import product

import numpy as np
import pytest

from becalm.cleaning.pipeline import Cleaned, clean
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording

ROWS = 3000


def walk() -> Floats:
    rng = np.random.default_rng(7)
    return np.cumsum(0.03 * rng.normal(size=ROWS)) + rng.normal(size=ROWS)


def cleaned(z: Floats, causal: bool, robust: bool) -> Cleaned:
    recording = Recording(z, rate_hz=500.0)
    return clean(recording, tune(recording, causal=causal, wishes=Wishes(robust=robust)))


@cache
def good(causal: bool, robust: bool) -> Cleaned:
    return cleaned(walk(), causal, robust)


ABSURD = [1e12, -1e30, 1e99]
WAYS = list(product([0, 1, 20, 1500], [True, False], [True, False]))
FAR = list(product([0, 1, 20, 1500, 2999], [True, False]))


@pytest.mark.parametrize(
    ("row", "causal", "robust", "value"), [(*way, ABSURD[k % 3]) for k, way in enumerate(WAYS)]
)  # each value at several rows and in each mode
def test_what_no_sensor_gives_is_as_if_it_were_missing(row: int, causal: bool, robust: bool, value: float) -> None:
    z, missing = walk(), walk()
    z[row], missing[row] = value, np.nan
    out, right = cleaned(z, causal, robust), cleaned(missing, causal, robust)
    assert np.array_equal(out.signal.samples, right.signal.samples, equal_nan=True)
    (verdicts,) = out.verdicts.values()
    assert np.flatnonzero(verdicts == Verdict.OVERRANGE).tolist() == [row]
    (limits,) = [channel.limits for channel in out.recipe.channel]
    assert limits is not None
    assert limits.largest is not None
    assert 10 < limits.largest < abs(value)
    assert Recipe.from_toml(out.recipe.to_toml()) == out.recipe


@pytest.mark.parametrize(
    ("row", "causal", "value"), [(row, causal, 1e4 if (k + causal) % 3 else 1e8) for k, (row, causal) in enumerate(FAR)]
)
def test_a_reading_far_out_tunes_nothing_and_is_overcome(row: int, causal: bool, value: float) -> None:
    z = walk()
    z[row] = value
    out, right = cleaned(z, causal, False), good(causal, False)
    off = np.abs(out.signal.samples - right.signal.samples)[:, 0]
    assert np.delete(off, np.arange(row, min(row + 60, ROWS))).max() < 0.5
    assert out.recipe.channel[0].noise_std == pytest.approx(right.recipe.channel[0].noise_std, rel=0.02)


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("row", [0, 20, 1500])
def test_a_robust_filter_is_not_tuned_by_a_reading_far_out_either(row: int, causal: bool) -> None:
    z = walk()
    z[row] = 1e6
    noises = []
    for out in (cleaned(z, causal, True), good(causal, True)):
        (channel,) = out.recipe.channel
        assert channel.switching is not None
        noises.append(channel.switching.mode[0].noise_std)
    assert noises[0] == pytest.approx(noises[1], rel=0.05)
