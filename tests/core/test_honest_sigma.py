"""Sigma is honest: when the model is true, the truth lies within one sigma in 68 % of the samples."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.filter.filtering import Estimate, kalman_filter, run_filter
from becalm.core.filter.smoothing import kalman_smoother, run_smoother
from becalm.core.model.components import motion
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.metrics.truth import coverage, rms_error
from becalm.metrics.whiteness import mean_nis, whiteness
from drawn import draw

RECORDS, ROWS, CUTOFF = 40, 2000, 0.5
ONE_SIGMA, WITHIN = 0.683, 0.03


def true_model(order: int) -> Model:
    return motion(order, 2.0 * CUTOFF ** (2 * order)).to_model(1.0, 2.0)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("causal", [True, False])
def test_the_truth_lies_within_one_sigma_in_68_percent(order: int, causal: bool) -> None:
    model, rng = true_model(order), np.random.default_rng(order)
    shares, squares = [], []
    for _ in range(RECORDS):
        truth, z = draw(model, ROWS, rng)
        z[rng.random(ROWS) < 0.1] = np.nan
        got = (kalman_filter if causal else kalman_smoother)(model, z)
        shares.append(coverage(got.signal[:, 0], got.sigma[:, 0], truth))
        told = np.isfinite(got.signal[:, 0])
        squares.append(np.mean((got.signal[told, 0] - truth[told]) ** 2 / got.sigma[told, 0] ** 2))
    assert np.mean(shares) == pytest.approx(ONE_SIGMA, abs=WITHIN)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("causal", [True, False])
def test_sigma_is_honest_at_every_row_of_short_records(order: int, causal: bool) -> None:
    """Over many records, row by row: the opening of a flat start and both ends among them."""
    model, rng = true_model(order), np.random.default_rng(10 + order)
    count, rows = 3000, 12
    hits = np.zeros(rows)
    for _ in range(count):
        truth, z = draw(model, rows, rng)
        got = (kalman_filter if causal else kalman_smoother)(model, z)
        hits += np.abs(got.signal[:, 0] - truth) <= got.sigma[:, 0]
    np.testing.assert_allclose(hits / count, ONE_SIGMA, rtol=0, atol=WITHIN)


@pytest.mark.parametrize("causal", [True, False])
def test_sigma_is_honest_in_irregular_time(causal: bool) -> None:
    rng, part, shares = np.random.default_rng(3), motion(2, 0.05), []
    for _ in range(RECORDS):
        elapsed = rng.exponential(size=ROWS)
        line = elapsed_timeline(part, 1.0, elapsed)
        x, truth = np.zeros(2), np.empty(ROWS)
        for k in range(ROWS):
            if k:
                step = line.step_before(k)
                x = line.system.F[step] @ x + np.linalg.cholesky(line.system.Q[step]) @ rng.normal(size=2)
            truth[k] = x[0]
        z = (truth + rng.normal(size=ROWS))[:, np.newaxis]
        model = part.to_model(1.0, 1.0)
        got: Estimate = run_filter(model, line, z).estimate if causal else run_smoother(model, line, z)
        shares.append(coverage(got.signal[:, 0], got.sigma[:, 0], truth))
    assert np.mean(shares) == pytest.approx(ONE_SIGMA, abs=WITHIN)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_smoother_beats_the_filter_and_the_filter_the_readings(order: int) -> None:
    truth, z = draw(true_model(order), ROWS, np.random.default_rng(20 + order))
    errors = [rms_error(run(true_model(order), z).signal[:, 0], truth) for run in (kalman_smoother, kalman_filter)]
    assert errors[0] < errors[1] < rms_error(z, truth)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_innovations_of_the_true_model_are_white_and_of_the_right_size(order: int) -> None:
    model = true_model(order)
    _, z = draw(model, 20_000, np.random.default_rng(30 + order))
    got = kalman_filter(model, z)
    normalised = (got.innovations / got.innovation_sigma)[:, 0]
    assert 0.98 < mean_nis(normalised) < 1.02
    assert whiteness(normalised).p_value > 0.01


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize(("factor", "sign"), [(10.0, -1), (0.1, 1)])
def test_a_wrong_q_shows_in_the_innovations(order: int, factor: float, sign: int) -> None:
    """Neighbours correlate with the sign that tells the direction: sluggish above 0, nervous below."""
    model = true_model(order)
    _, z = draw(model, 20_000, np.random.default_rng(40 + order))
    wrong = Model(model.F, model.H, factor * model.Q, model.R)
    got = kalman_filter(wrong, z)
    found = whiteness((got.innovations / got.innovation_sigma)[:, 0])
    assert found.p_value < 1e-6
    assert np.sign(found.first_correlation) == sign
