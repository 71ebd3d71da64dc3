"""Classic filters at equal noise and equal lag: held against closed forms and against what they do to noise."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.classic.matching import best_of, best_with_truth, equal_lag, equal_noise, lag, noise_gain
from becalm.classic.register import CAUSAL, CLASSICS, HIGHEST, LOWEST, USUAL, ZERO_PHASE, Classic
from becalm.core.closed_forms import butterworth_noise_gain
from becalm.metrics.truth import rms_error

CALM = [classic for classic in CLASSICS.values() if classic.reduces_noise]
NAMES = [classic.name for classic in CALM]


def test_the_noise_of_an_average_and_of_an_exponential_are_those_of_the_book() -> None:
    assert noise_gain(CLASSICS["moving average"], 0.443 / 50) == pytest.approx(1 / 50, rel=1e-9)
    theta = np.exp(-2 * np.pi * 0.01)
    assert noise_gain(CLASSICS["exponential average"], 0.01) == pytest.approx((1 - theta) / (1 + theta), rel=1e-9)
    assert noise_gain(CLASSICS["Butterworth 2"], 0.01) == pytest.approx(butterworth_noise_gain(2, 0.01), rel=1e-3)


@pytest.mark.parametrize("classic", CALM, ids=NAMES)
def test_the_noise_told_is_the_noise_left(classic: Classic) -> None:
    z = np.random.default_rng(1).normal(size=200_000)
    for cutoff in (0.2, 0.02):
        assert classic.clean(z, cutoff).var() == pytest.approx(noise_gain(classic, cutoff), rel=0.05)


@pytest.mark.parametrize("classic", CALM, ids=NAMES)
@pytest.mark.parametrize("gain", [0.3, 0.003])
def test_equal_noise_is_equal_as_far_as_the_dial_allows(classic: Classic, gain: float) -> None:
    cutoff = equal_noise(classic, gain)
    assert LOWEST < cutoff < HIGHEST
    assert noise_gain(classic, cutoff * 1.01) >= gain * (1 - 1e-3)
    assert noise_gain(classic, cutoff / 1.01) <= gain * (1 + 1e-3)


def test_the_lag_of_averages_is_half_of_their_length() -> None:
    assert lag(CLASSICS["moving average"], 0.443 / 51) == pytest.approx(25.0, abs=0.01)
    assert lag(CLASSICS["moving median"], 0.443 / 51) == pytest.approx(25.0, abs=0.6)
    theta = np.exp(-2 * np.pi * 0.01)
    assert lag(CLASSICS["exponential average"], 0.01) == pytest.approx(theta / (1 - theta), rel=1e-6)
    assert all(lag(classic, 0.01) == 0 for classic in ZERO_PHASE)


@pytest.mark.parametrize("classic", [one for one in CAUSAL if one.reduces_noise], ids=lambda one: one.name)
def test_equal_lag_is_equal_as_far_as_the_dial_allows(classic: Classic) -> None:
    cutoff = equal_lag(classic, 20.0)
    assert lag(classic, cutoff * 1.01) <= 20.0 * (1 + 1e-3)
    assert lag(classic, cutoff / 1.01) >= 20.0 * (1 - 1e-3)


@pytest.mark.parametrize("classic", CLASSICS.values(), ids=CLASSICS)
def test_best_with_truth_is_no_worse_than_what_is_near_it(classic: Classic) -> None:
    rng = np.random.default_rng(2)
    truth = np.sin(np.arange(3000) / 60)
    z = truth + 0.3 * rng.normal(size=3000)
    best = best_with_truth(classic, z, truth)
    error = rms_error(classic.clean(z, best), truth)
    near = min(rms_error(classic.clean(z, best * by), truth) for by in (0.5, 0.8, 1.25, 2.0))
    assert error <= near * (1 + (1e-9 if classic.reduces_noise else 0.01))  # few settings are tried of an adaptive one
    if classic.reduces_noise:
        assert error < 0.3 / 2


@pytest.mark.parametrize("classic", CALM, ids=NAMES)
@pytest.mark.parametrize("count", [12, 600])
def test_best_with_truth_is_the_least_of_a_dense_grid(classic: Classic, count: int) -> None:
    rng = np.random.default_rng(8)
    truth = np.zeros(count) if count == 600 else np.cumsum(0.2 * rng.normal(size=count))
    z = truth + rng.normal(size=count)
    error = rms_error(classic.clean(z, best_with_truth(classic, z, truth)), truth)
    dense = min(rms_error(classic.clean(z, cutoff), truth) for cutoff in np.geomspace(LOWEST, HIGHEST, 300))
    assert error <= 1.03 * dense  # of long windows in mere noise it jumps, from one setting to the next


def test_a_setting_that_changes_nothing_any_more_is_not_told() -> None:
    z = np.random.default_rng(9).normal(size=400)
    assert best_with_truth(CLASSICS["centred average"], z, np.zeros(400)) > 0.443 / 500


@pytest.mark.parametrize("causal", [True, False])
def test_the_best_of_some_filters_is_one_of_them_in_its_best_setting(causal: bool) -> None:
    truth = np.sin(np.arange(2000) / 60)
    z = truth + 0.3 * np.random.default_rng(2).normal(size=2000)
    best = best_of(USUAL[causal], z, truth)
    assert {one.causal for one in USUAL[causal]} == {causal}
    assert best.error == rms_error(best.classic.clean(z, best.cutoff), truth)
    assert all(best.error <= rms_error(one.clean(z, 0.02), truth) for one in USUAL[causal])
