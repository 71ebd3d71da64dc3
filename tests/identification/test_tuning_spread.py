"""The spread of a tuning, beside real filters at other tunings, and tunings of other records."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio
from becalm.identification.cross_validation import criterion, residuals_by_smoothing
from becalm.identification.likelihood import Evidence, Tuning, find_ratio, tune_motion
from becalm.identification.spectrum import ToneOscillator
from becalm.identification.trust.tuning_spread import (
    LONG,
    delta_widening,
    log_ratio_variance,
    posterior_widening,
    tuning_spread,
)
from becalm.metrics.truth import coverage
from walks import clean, draw

SETTLED = slice(2000, -2000)


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize(("order", "ratio"), [(1, 0.02), (2, 1e-3), (3, 1e-2)])
def test_the_slope_is_that_of_real_filters(order: int, ratio: float, causal: bool) -> None:
    _, z = draw(order, ratio, 100_000, np.random.default_rng(order))
    tuning, by = Tuning(order, ratio, 1.0, 500), 0.05
    low, high = (clean(replace(tuning, ratio=ratio * np.exp(step)), z, causal)[0] for step in (-by, by))
    _, sigma = clean(tuning, z, causal)
    moved = np.mean(((high - low) / (2 * by))[SETTLED] ** 2) / np.mean(sigma[SETTLED] ** 2)
    told = delta_widening(tuning, causal) ** 2 - 1
    assert told == pytest.approx(log_ratio_variance(tuning) * moved, rel=0.05)


@pytest.mark.parametrize("causal", [True, False])
def test_the_widened_sigma_is_the_error_over_draws_of_the_tuning(causal: bool) -> None:
    rng = np.random.default_rng(4)
    truth, z = draw(1, 0.02, 50_000, rng)
    tuning = Tuning(1, 0.02, 1.0, 300)
    thetas = np.sqrt(log_ratio_variance(tuning)) * rng.normal(size=100)
    exact, sigma = clean(tuning, z, causal)
    others = [clean(replace(tuning, ratio=0.02 * np.exp(theta)), z, causal)[0] for theta in thetas]
    added = np.mean([np.mean((other - exact)[SETTLED] ** 2) for other in others]) / np.mean(sigma[SETTLED] ** 2)
    spread = delta_widening(tuning, causal) ** 2 - 1
    assert 0.005 < spread == pytest.approx(added, rel=0.3)  # a hundred squares of a normal number scatter by 14 %
    errors = np.mean([np.mean((other - truth)[SETTLED] ** 2) for other in others])
    assert errors == pytest.approx((1 + spread) * np.mean(sigma[SETTLED] ** 2), rel=0.05)


def test_the_likelihood_scatters_as_it_is_told_to() -> None:
    found = []
    for seed in range(80):
        _, z = draw(1, 0.05, 1000, np.random.default_rng([1, seed]))
        found.append(np.log(tune_motion(1, Evidence.of(z, np.ones(1000))).ratio))
    told = np.sqrt(log_ratio_variance(Tuning(1, 0.05, 1.0, 1000)))
    assert np.std(found) == pytest.approx(told, rel=0.25)  # 80 records tell a standard deviation to 8 %


@pytest.mark.parametrize(("order", "ratio"), [(1, 0.05), (2, 1.0)])
def test_cross_validation_scatters_as_it_is_told_to(order: int, ratio: float) -> None:
    found = []
    for seed in range(60):
        _, z = draw(order, ratio, 1000, np.random.default_rng([2, order, seed]))
        residuals, count = residuals_by_smoothing(order, Evidence.of(z, np.ones(1000)))
        least = find_ratio(order, lambda r: criterion(*residuals(r), count), 1000)  # noqa: B023
        found.append(np.log(least.ratio))
    tuning = Tuning(order, ratio, 1.0, 1000, loss=0.0)
    assert np.std(found) == pytest.approx(np.sqrt(log_ratio_variance(tuning)), rel=0.3)
    assert log_ratio_variance(tuning) > log_ratio_variance(replace(tuning, loss=np.nan))  # none tells more


@cache
def any_walks() -> list[tuple[Floats, Evidence, Tuning]]:
    """The cut-off is drawn as the prior has it; of few readings, tuned by likelihood alone."""
    rng, found = np.random.default_rng(6), []
    for _ in range(150):
        cutoff = np.exp(rng.uniform(np.log(2 * np.pi * 0.02 / 60), np.log(4.0)))
        truth, z = draw(1, cutoff_to_ratio(1, cutoff), 60, rng)
        evidence = Evidence.of(z, np.ones(60))
        found.append((truth, evidence, tune_motion(1, evidence)))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("causal", [True, False])
def test_over_all_walks_that_there_may_be_sigma_holds(causal: bool) -> None:
    shares, before, after = [], [], []
    for truth, evidence, tuning in any_walks():
        widening = 1 + tuning_spread(tuning, evidence, causal)
        signal, sigma = clean(tuning, evidence.z[:, 0], causal)
        told = np.isfinite(sigma)
        shares.append(coverage(signal, widening * sigma, truth))
        before.append(np.mean(((signal - truth) / sigma)[told] ** 2))
        after.append(np.mean(((signal - truth) / (widening * sigma))[told] ** 2))
    errors = np.std([before, after], axis=1) / np.sqrt(len(after))  # from record to record
    assert np.mean(before) > 1 + 2 * errors[0]
    assert np.mean(after) == pytest.approx(1.0, abs=3 * errors[1])
    assert np.mean(shares) == pytest.approx(0.683, abs=0.03)


def test_a_sine_is_no_walk_and_widens_nothing_by_walks() -> None:
    z = 20 * np.sin(0.4 * np.arange(800)) + np.random.default_rng(1).normal(size=800)
    evidence = Evidence.of(z, np.ones(800))
    tuning = tune_motion(2, evidence)
    assert posterior_widening(tuning, evidence, causal=False) is None
    assert 0 <= tuning_spread(tuning, evidence, causal=False) < 0.02


def test_gaps_and_few_readings_are_no_obstacle() -> None:
    _, z = draw(1, 0.05, 200, np.random.default_rng(3))
    z[50:120] = np.nan
    evidence = Evidence.of(z, np.ones(200))
    assert 0 < tuning_spread(tune_motion(1, evidence), evidence, causal=False) < 1
    few = Evidence.of(z[:8], np.ones(8))
    assert np.isfinite(tuning_spread(tune_motion(1, few), few, causal=True))


def test_a_long_record_is_widened_by_next_to_nothing() -> None:
    _, z = draw(1, 0.05, LONG, np.random.default_rng(3))
    evidence = Evidence.of(z, np.ones(LONG))
    tuning = tune_motion(1, evidence)
    assert 0 < tuning_spread(tuning, evidence, causal=True) < 0.01
    assert tuning_spread(replace(tuning, at_edge="low"), evidence, causal=True) == 0.0
    toned = replace(tuning, tones=(ToneOscillator(1.0, 0.01, 0.1),))
    assert 0 < tuning_spread(toned, evidence, causal=False) < 0.01
    assert delta_widening(Tuning(1, 0.0, 1.0, 100), causal=True) == 1.0  # never settles
    assert delta_widening(Tuning(1, 0.05, 1.0, 0), causal=True) == 1.0  # no reading tells it


@pytest.mark.parametrize("causal", [True, False])
def test_units_do_not_matter(causal: bool) -> None:
    own, huge = (Tuning(3, 1e-4, noise, 5000) for noise in (1.0, 1e158))
    assert delta_widening(own, causal) > 1.0
    assert delta_widening(huge, causal) - 1 == pytest.approx(delta_widening(own, causal) - 1, rel=1e-3)
