"""Tuning for smoothing: near the best that the truth could choose, whatever is missing."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio
from becalm.core.filter.smoothing import run_smoother
from becalm.core.model.components import motion
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.identification.cross_validation import LONG, criterion, simplest, stretches_for_spectra, tune_smoother
from becalm.identification.likelihood import Evidence, Tuning
from becalm.metrics.truth import rms_error

NOISE = 0.3


def wave(t: Floats) -> Floats:
    return np.asarray(np.sin(0.05 * t) + 0.3 * np.sin(0.11 * t + 1))


def error_of(tuning: Tuning, evidence: Evidence, truth: Floats) -> float:
    timeline = elapsed_timeline(tuning.component, tuning.noise_variance, evidence.elapsed)
    model = tuning.component.to_model(1.0, tuning.noise_variance)
    return rms_error(run_smoother(model, timeline, evidence.z).signal[:, 0], truth)


def best_with_truth(evidence: Evidence, truth: Floats) -> float:
    """The least error of any order and ratio, the truth being known."""
    cutoffs = np.geomspace(0.02, 1.0, 25)
    tunings = [Tuning(n, cutoff_to_ratio(n, float(c)), NOISE**2, 0) for n in (1, 2, 3, 4, 5) for c in cutoffs]
    return min(error_of(tuning, evidence, truth) for tuning in tunings)


def record(kind: str) -> tuple[Evidence, Floats]:
    rng = np.random.default_rng(3)
    rows = 600 if kind == "short" else 6000
    elapsed = np.ones(rows)
    if kind == "stamps":
        elapsed = rng.uniform(0.5, 1.5, rows)
    t = np.cumsum(elapsed)
    z = wave(t) + NOISE * rng.normal(size=rows)
    if kind == "holes":
        z[rng.random(rows) < 0.02] = np.nan
    elif kind == "two gaps":
        z[1500:1600], z[4000] = np.nan, np.nan
    return Evidence.of(z, elapsed), wave(t)[np.isfinite(z)]


@pytest.mark.parametrize("kind", ["whole", "two gaps", "holes", "stamps", "short"])
def test_the_least_loss_is_near_the_least_error(kind: str) -> None:
    evidence, truth = record(kind)
    assert bool(stretches_for_spectra(evidence)) == (kind in ("whole", "two gaps"))
    found = min(tune_smoother(evidence), key=lambda tuning: tuning.loss)
    assert found.order >= 3
    assert found.noise_variance == pytest.approx(NOISE**2, rel=0.06 if kind != "short" else 0.2)
    assert error_of(found, evidence, truth) <= 1.05 * best_with_truth(evidence, truth)


def test_both_roads_lead_to_the_same_tuning() -> None:
    """The spectrum of a long record and its smoothers themselves; steps longer than jitter tell them apart."""
    evidence, _ = record("whole")
    singly = Evidence(evidence.z, np.where(np.arange(len(evidence.z)) % 1000 == 500, 1.021, 1.0))
    assert not stretches_for_spectra(singly)
    for near, far in zip(tune_smoother(evidence), tune_smoother(singly), strict=True):
        assert near.loss == pytest.approx(far.loss, abs=2e-3)
        assert near.ratio ** (0.5 / near.order) == pytest.approx(far.ratio ** (0.5 / far.order), rel=0.05)
        assert near.noise_variance == pytest.approx(far.noise_variance, rel=5e-3)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_motion_is_found_as_it_was_drawn(order: int) -> None:
    """A model that is right loses little to the likelihood: the cut-off within a fifth, r within 3 %."""
    rng, rows, cutoff = np.random.default_rng(order), 20_000, 0.2
    model = motion(order, cutoff_to_ratio(order, cutoff)).to_model(1.0, 1.0)
    x, truth = np.zeros(order), np.empty(rows)
    root = np.linalg.cholesky(model.process_covariance)
    for k in range(rows):
        x = model.F @ x + root @ rng.normal(size=order)
        truth[k] = x[0]
    found = min(tune_smoother(Evidence.of(truth + rng.normal(size=rows), np.ones(rows))), key=lambda t: t.loss)
    assert found.noise_variance == pytest.approx(1.0, rel=0.03)
    if found.order == order:
        assert found.ratio ** (0.5 / order) == pytest.approx(cutoff, rel=0.2)


@pytest.mark.parametrize("rows", [8, 9, 12, 40, LONG - 1, LONG])
def test_white_noise_is_smoothed_away(rows: int) -> None:
    z = np.random.default_rng(rows).normal(size=rows)
    found = min(tune_smoother(Evidence.of(z, np.ones(rows))), key=lambda tuning: tuning.loss)
    assert found.ratio ** (0.5 / found.order) < (2.0 if rows < 40 else 0.2)


def test_the_criterion_prefers_less_residual_and_less_freedom() -> None:
    assert criterion(1.0, 0.1, 1000) < criterion(1.1, 0.1, 1000)
    assert criterion(1.0, 0.1, 1000) < criterion(1.0, 0.2, 1000)
    assert criterion(1.0, 0.1, 100) > criterion(1.0, 0.1, 1000)  # of few parameters it is known less well
    assert criterion(1.0, 1.0, 1000) == np.inf
    assert criterion(0.0, 0.1, 1000) == np.inf


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_straight_line_is_a_walking_slope(seed: int) -> None:
    """The transform of a record takes the line between its ends off, which a random walk could not follow there."""
    z = 1e-3 * np.arange(8192) + np.random.default_rng(seed).normal(0, 0.2, 8192)
    assert simplest(tune_smoother(Evidence.of(z, np.ones(8192)))).order == 2
