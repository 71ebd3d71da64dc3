"""Tuning recovers the noise that made a record, whatever its unit, offset, gaps and time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio
from becalm.core.filter.filtering import run_filter
from becalm.core.model.components import ORDERS, motion
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.identification.choose import choose
from becalm.identification.likelihood import UNSCORED, Candidate, Evidence, Tuning, tune_motion
from becalm.identification.risk import retune

R_WITHIN = 0.02
Q_WITHIN = 0.27


def simulate(order: int, ratio: float, r: float, elapsed: Floats, seed: int) -> Floats:
    """Draw readings (N,) of a motion of density ratio * r, at times `elapsed` apart."""
    rng = np.random.default_rng(seed)
    line = elapsed_timeline(motion(order, ratio * r), r, elapsed)
    roots = [np.linalg.cholesky(Q) if Q.any() else Q for Q in line.system.Q]
    w, x, truth = rng.normal(size=(len(elapsed), order)), np.zeros(order), np.empty(len(elapsed))
    for k in range(len(elapsed)):
        step = line.step_before(k)
        if step >= 0:
            x = line.system.F[step] @ x + roots[step] @ w[k]
        truth[k] = x[0]
    z: Floats = truth + np.sqrt(r) * rng.normal(size=len(elapsed))
    return z


def even(count: int) -> Floats:
    elapsed = np.ones(count)
    elapsed[0] = 0.0
    return elapsed


RECORDS = {order: simulate(order, 0.3 ** (2 * order), 0.5, even(4000), seed=order) for order in ORDERS}


def tuned(order: int, z: Floats, elapsed: Floats) -> Tuning:
    return tune_motion(order, Evidence.of(z, elapsed))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("order", "ratio"), [(1, 1.8e-3), (2, 8e-4), (3, 1e-4)])
def test_tuning_recovers_q_and_r(order: int, ratio: float, seed: int) -> None:
    """N = 50 000: q within 27 %, r within 2 %, four standard errors of the random walk."""
    r = 0.5
    found = tuned(order, simulate(order, ratio, r, even(50_000), seed), even(50_000))
    assert found.noise_variance == pytest.approx(r, rel=R_WITHIN)
    assert found.ratio * found.noise_variance == pytest.approx(ratio * r, rel=Q_WITHIN)
    assert found.at_edge == ""
    assert found.count == 50_000 - UNSCORED


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("order", ORDERS)
def test_the_order_that_made_the_record_is_chosen(order: int, seed: int) -> None:
    z = simulate(order, 0.2 ** (2 * order), 3.0, even(20_000), seed)
    choice = choose(z, even(20_000))
    assert choice.kind == "motion"
    assert choice.tuning is not None
    assert choice.tuning.order == order
    assert [rival.order for rival in choice.rivals] == list(ORDERS)
    assert choice.tuning.log_likelihood == max(rival.log_likelihood for rival in choice.rivals)


@pytest.mark.parametrize("order", ORDERS)
def test_the_found_tuning_is_a_maximum_of_the_likelihood(order: int) -> None:
    candidate = Candidate(order, Evidence.of(RECORDS[order], even(4000)))
    found = tuned(order, RECORDS[order], even(4000))
    best = candidate.score(found.ratio).log_likelihood
    assert best == found.log_likelihood
    ratios = found.ratio * np.geomspace(1e-4, 1e4, 81)
    assert max(candidate.score(float(ratio)).log_likelihood for ratio in ratios) <= best + 0.01


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_the_score_is_the_filters_likelihood_at_its_best_r(order: int, factor: float) -> None:
    """All but the first three readings count, for every order alike."""
    elapsed, z = even(4000), RECORDS[order].copy()
    z[1000:1100] = np.nan
    evidence = Evidence.of(z, elapsed)
    ratio = factor * cutoff_to_ratio(order, 0.3)
    score = Candidate(order, evidence).score(ratio)

    def likelihood(r: float) -> float:
        part = motion(order, ratio * r)
        run = run_filter(part.to_model(1.0, r), elapsed_timeline(part, r, evidence.elapsed), evidence.z)
        nu, S = run.estimate.innovations[UNSCORED:, 0], run.estimate.innovation_sigma[UNSCORED:, 0] ** 2
        return float(-0.5 * np.sum(nu**2 / S + np.log(2 * np.pi * S)))

    assert score.log_likelihood == pytest.approx(likelihood(score.noise_variance), rel=1e-10)
    assert score.used == len(evidence.z) - UNSCORED
    for worse in (0.97, 1.03):
        assert likelihood(worse * score.noise_variance) < score.log_likelihood


@pytest.mark.parametrize("order", ORDERS)
def test_stamped_time_with_gaps_gives_the_tuning_of_even_time(order: int) -> None:
    """The same readings, once as rows of NaN and once as longer steps."""
    z = RECORDS[order].copy()
    z[np.random.default_rng(5).random(4000) < 0.2] = np.nan
    z[2000:2400] = np.nan
    seen = np.flatnonzero(np.isfinite(z))
    elapsed = np.diff(seen, prepend=seen[0]).astype(float)
    rows, stamps = tuned(order, z, even(4000)), tuned(order, z[seen], elapsed)
    assert stamps.ratio == pytest.approx(rows.ratio, rel=1e-9)
    assert stamps.noise_variance == pytest.approx(rows.noise_variance, rel=1e-9)
    assert stamps.log_likelihood == pytest.approx(rows.log_likelihood, rel=1e-12)


@pytest.mark.parametrize("order", ORDERS)
def test_irregular_time_is_tuned_to_its_truth(order: int) -> None:
    elapsed = np.random.default_rng(6).exponential(size=8000)
    ratio = 0.3 ** (2 * order)
    found = tuned(order, simulate(order, ratio, 2.0, elapsed, seed=order), elapsed)
    assert found.noise_variance == pytest.approx(2.0, rel=0.1)
    assert found.ratio == pytest.approx(ratio, rel=0.5)


@given(
    order=st.sampled_from(ORDERS),
    scale=st.integers(-40, 40).map(lambda power: 2.0**power) | st.floats(1e-6, 1e6),
    sign=st.sampled_from([-1.0, 1.0]),
)
@settings(max_examples=25)
def test_the_unit_does_not_matter(order: int, scale: float, sign: float) -> None:
    z, found = RECORDS[order][:1000], tuned(order, RECORDS[order][:1000], even(1000))
    other = tuned(order, sign * scale * z, even(1000))
    assert other.ratio == pytest.approx(found.ratio, rel=1e-3)
    assert other.noise_variance == pytest.approx(scale**2 * found.noise_variance, rel=1e-3)
    shift = found.count * np.log(scale)
    assert other.log_likelihood + shift == pytest.approx(found.log_likelihood, rel=1e-6)


@given(order=st.sampled_from(ORDERS), offset=st.floats(-1e4, 1e4), slope=st.floats(-10, 10))
@settings(max_examples=25)
def test_an_offset_does_not_matter_and_from_order_two_on_no_slope(order: int, offset: float, slope: float) -> None:
    z, found = RECORDS[order][:1000], tuned(order, RECORDS[order][:1000], even(1000))
    other = tuned(order, z + offset + (slope * np.arange(1000.0) if order > 1 else 0.0), even(1000))
    assert other.ratio == pytest.approx(found.ratio, rel=1e-3)
    assert other.noise_variance == pytest.approx(found.noise_variance, rel=1e-3)
    assert other.log_likelihood == pytest.approx(found.log_likelihood, rel=1e-6)


def test_white_noise_that_passed_for_motion_is_given_back_by_a_clock_that_jitters_too() -> None:
    """A sine is no motion: most likely half of the noise would be; the white floor of its spectrum is all of it."""
    rng, rows = np.random.default_rng(4), 6000
    jittery = 1.0 + 0.003 * np.diff(rng.normal(size=rows + 1))
    noise, found = rng.normal(size=rows), []
    for elapsed in (np.ones(rows), jittery):
        evidence = Evidence.of(2 * np.sin(0.5 * np.cumsum(elapsed)) + noise, elapsed)
        likeliest = tune_motion(1, evidence)
        assert likeliest.noise_variance < 0.5
        found.append(retune(likeliest, evidence))
    for tuning in found:
        assert tuning.noise_variance == pytest.approx(1.0, rel=0.1)
    assert found[1].ratio == pytest.approx(found[0].ratio, rel=1e-2)


def test_evidence_keeps_the_time_between_the_readings_that_arrived() -> None:
    z = np.array([np.nan, 1.0, np.nan, np.nan, 2.0, 3.0, np.inf])
    evidence = Evidence.of(z, even(7))
    assert np.array_equal(evidence.z, [[1.0], [2.0], [3.0]])
    assert np.array_equal(evidence.elapsed, [0.0, 3.0, 1.0])


@pytest.mark.parametrize("order", ORDERS)
def test_stretches_a_long_time_apart_are_tuned_like_one(order: int) -> None:
    """Nothing can be followed across ten million steps; each stretch tells the same noise."""
    elapsed, z = even(4000), RECORDS[order].copy()
    elapsed[[1000, 2500]] = 1e7
    apart, whole = tuned(order, z, elapsed), tuned(order, z, even(4000))
    assert apart.noise_variance == pytest.approx(whole.noise_variance, rel=0.02)
    assert np.log(apart.ratio / whole.ratio) == pytest.approx(0.0, abs=2 * order * 0.05)
    assert apart.count == 4000 - 3 * UNSCORED
    assert choose(z, elapsed).tuning is not None
