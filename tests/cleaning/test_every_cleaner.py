"""House rules that every cleaner keeps: Kalman, Butterworth, median; one register, no private exceptions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from becalm.classic.bridging import hold_last
from becalm.classic.causal import notch
from becalm.classic.register import CLASSICS
from becalm.cleaning.pipeline import clean
from becalm.cleaning.tuning import tune
from becalm.core.arrays import Floats
from becalm.core.recording import Recording

Cleaner = Callable[[Floats], Floats]

RATE_HZ, CUTOFF = 100.0, 0.05
NOISY = np.cumsum(0.1 * np.random.default_rng(1).normal(size=3000)) + np.random.default_rng(2).normal(size=3000)


def kalman(causal: bool) -> Cleaner:
    recipe = tune(Recording(NOISY, rate_hz=RATE_HZ), causal=causal)
    return lambda z: clean(Recording(z, rate_hz=RATE_HZ), recipe).signal.samples[:, 0]


CLEANERS: dict[str, Cleaner] = {
    "Kalman causal": kalman(True),
    "Kalman smoothed": kalman(False),
    "notch": lambda z: notch(hold_last(z), CUTOFF),
    **{name: partial(classic.clean, cutoff=CUTOFF) for name, classic in CLASSICS.items()},
}


@pytest.mark.parametrize("cleaner", CLEANERS.values(), ids=CLEANERS)
class TestEveryCleaner:
    def test_the_shape_stays_and_so_does_the_input(self, cleaner: Cleaner) -> None:
        before = NOISY.copy()
        out = cleaner(NOISY)
        assert out.shape == NOISY.shape
        assert np.isfinite(out).all()
        assert np.array_equal(NOISY, before)
        assert not np.shares_memory(out, NOISY)

    def test_there_is_no_hidden_zero(self, cleaner: Cleaner) -> None:
        np.testing.assert_allclose(cleaner(NOISY + 10), cleaner(NOISY) + 10, atol=1e-8)

    def test_one_hole_stays_one_hole(self, cleaner: Cleaner) -> None:
        holed = NOISY.copy()
        holed[5] = holed[1000:1003] = np.nan
        assert np.isfinite(cleaner(holed)).all()

    def test_what_is_missing_at_the_ends_spoils_nothing(self, cleaner: Cleaner) -> None:
        holed = NOISY.copy()
        holed[:3] = holed[-3:] = np.nan
        assert np.isfinite(cleaner(holed)[3:]).all()

    def test_twice_gives_the_same(self, cleaner: Cleaner) -> None:
        assert np.array_equal(cleaner(NOISY), cleaner(NOISY))


@pytest.mark.parametrize("name", [name for name, classic in CLASSICS.items() if classic.causal])
def test_what_is_causal_knows_no_later_reading(name: str) -> None:
    cleaner, other = CLEANERS[name], NOISY.copy()
    other[2000:] += 5
    np.testing.assert_allclose(cleaner(other)[:2000], cleaner(NOISY)[:2000], atol=1e-9)
