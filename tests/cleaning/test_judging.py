"""Judging innovations: in blocks as in one go, and said in a sentence."""

from __future__ import annotations

import dataclasses
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from becalm.cleaning.channels.judging import DESCRIBED, InnovationJudge, Judgement
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import run_filter
from becalm.core.model.components import motion
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.metrics.whiteness import mean_nis, uneven_share, whiteness


def judged(innovations: Floats, sigma: Floats | float) -> Judgement:
    judge = InnovationJudge()
    judge.add(innovations, sigma)
    return judge.judgement()


def assert_same(found: Judgement, expected: Judgement) -> None:
    for field in (one for one in dataclasses.fields(Judgement) if one.compare):
        got, wanted = getattr(found, field.name), getattr(expected, field.name)
        if isinstance(wanted, float):
            wanted = pytest.approx(wanted, rel=1e-9, abs=1e-14, nan_ok=True)
        assert got == wanted, field.name


@given(
    rows=st.one_of(st.integers(0, 40), st.integers(41, 20_000)),
    cuts=st.lists(st.floats(0, 1), max_size=8),
    missing=st.sampled_from([0.0, 0.01, 0.5, 1.0]),
    seed=st.integers(0, 99),
)
def test_any_blocks_are_judged_as_the_whole(rows: int, cuts: list[float], missing: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sigma = rng.uniform(0.1, 5.0, rows)
    innovations = sigma * rng.normal(size=rows)
    gone = rng.random(rows) < missing
    innovations[gone] = np.nan
    expected = judged(innovations, sigma)
    sigma[gone & (rng.random(rows) < 0.5)] = np.nan
    places = sorted(round(share * rows) for share in cuts)
    judge = InnovationJudge()
    for block, its_sigma in zip(np.split(innovations, places), np.split(sigma, places), strict=True):
        judge.add(block, its_sigma)
    assert_same(judge.judgement(), expected)


def test_a_judgement_is_that_of_the_metrics() -> None:
    rng = np.random.default_rng(3)
    innovations: Floats = lfilter([1.0], [1.0, -0.5], rng.normal(size=30_000))
    innovations[20_000:] *= 6
    found = judged(innovations, 2.0)
    white = whiteness(innovations / 2.0)
    assert (found.whiteness_p, found.first_correlation) == (white.p_value, white.first_correlation)
    assert found.predictable_share == white.predictable_share
    assert found.uneven_share == uneven_share(innovations / 2.0)
    assert found.nis_mean == pytest.approx(mean_nis(innovations / 2.0), rel=1e-12)


@pytest.mark.parametrize("sigma", [0.3, np.float64(0.3), np.array(0.3), np.full(5000, 0.3)], ids=str)
def test_a_settled_filter_has_one_sigma(sigma: Floats | float) -> None:
    innovations = 0.3 * np.random.default_rng(4).normal(size=5000)
    assert_same(judged(innovations, sigma), judged(innovations, np.full(5000, 0.3)))
    assert judged(innovations, sigma).says == DESCRIBED


@pytest.mark.parametrize(("phi", "character"), [(0.6, "sluggish"), (-0.6, "nervous")])
def test_what_is_predictable_has_a_character(phi: float, character: str) -> None:
    found = judged(lfilter([np.sqrt(1 - phi**2)], [1.0, -phi], np.random.default_rng(5).normal(size=200_000)), 1.0)
    assert not found.describes
    assert "36% of the innovation power is still predictable" in found.says
    assert character in found.says
    assert "of the record" not in found.says


def resonance(cycles: float, radius: float, white: float = 0.0) -> Judgement:
    """Judge innovations that have a resonance, at 200 Hz, beside white noise."""
    rng, turn = np.random.default_rng(7), 2 * np.pi * cycles
    innovations = lfilter([1.0], [1.0, -2 * radius * np.cos(turn), radius**2], rng.normal(size=20_000))
    innovations = innovations / innovations.std() + white * rng.normal(size=20_000)
    judge = InnovationJudge(1 / 200)
    judge.add(innovations, float(np.std(innovations)))
    return judge.judgement()


@pytest.mark.parametrize("cycles", [0.0, 0.11, 0.31, 0.5])
def test_the_guilty_frequency_is_named(cycles: float) -> None:
    found = resonance(cycles, 0.9)
    assert found.loudest_hz is not None
    assert found.loudest_hz == pytest.approx(200 * cycles, abs=2.0)
    assert f"most of it near {found.loudest_hz:.3g} Hz" in found.says
    assert found.verdict == "does not fit"


@pytest.mark.parametrize("cycles", [0.11, 0.31])
def test_a_narrow_resonance_is_an_exception(cycles: float) -> None:
    found = resonance(cycles, 0.99, white=1.0)
    assert found.verdict == "fits except"
    assert found.says.startswith(f"The model describes the signal except near {found.loudest_hz:.3g} Hz: ")
    assert found.describes


def test_noise_that_changes_is_said() -> None:
    innovations = np.random.default_rng(6).normal(size=20_000)
    innovations[5000:10_000] *= 8
    found = judged(innovations, 1.0)
    assert not found.describes
    assert "sigma is wrong by more than a factor of two in 25% of the record" in found.says


def test_of_nothing_nothing_is_claimed() -> None:
    for found in (InnovationJudge().judgement(), judged(np.full(9, np.nan), np.nan), judged(np.ones(7), 1.0)):
        assert found.verdict == "untold"
        assert not found.describes
        assert found.predictable_share is None
        assert "too few to judge" in found.says


def test_what_is_predictable_in_a_prediction_costs_as_much() -> None:
    found = judged(lfilter([0.8], [1.0, -0.6], np.random.default_rng(5).normal(size=200_000)), 1.0)
    assert found.excess_error == pytest.approx(1 / 0.8 - 1, abs=0.01)
    assert "costs 25% in rms error" in found.says


def test_a_smoother_is_judged_by_what_its_error_could_lose() -> None:
    """Innovations as predictable as these do not matter to a smoother that loses nothing by it."""
    innovations = lfilter([0.8], [1.0, -0.6], np.random.default_rng(5).normal(size=20_000))
    for excess, verdict in ((0.02, "fits"), (0.3, "does not fit")):
        judge = InnovationJudge()
        judge.add(innovations, 1.0)
        found = judge.judgement(Mock(return_value=excess))
        assert (found.verdict, found.excess_error) == (verdict, excess)


def test_an_estimate_is_one_block() -> None:
    rng = np.random.default_rng(7)
    z = np.cumsum(0.1 * rng.normal(size=10_000)) + rng.normal(size=10_000)
    z[rng.random(10_000) < 0.05] = np.nan
    component = motion(1, 0.01)
    timeline = elapsed_timeline(component, 1.0, np.ones(10_000))
    estimate = run_filter(component.to_model(1.0, 1.0), timeline, z[:, np.newaxis]).estimate
    judge = InnovationJudge()
    judge.add(estimate.innovations[:, 0], estimate.innovation_sigma[:, 0])
    found = judge.judgement()
    judge = InnovationJudge()
    for rows in np.split(np.arange(10_000), [1, 2, 3, 5000]):
        judge.add(estimate.innovations[rows, 0], estimate.innovation_sigma[rows, 0])
    assert_same(judge.judgement(), found)
    assert found.describes
    assert found.nis_mean == pytest.approx(1.0, abs=0.05)
