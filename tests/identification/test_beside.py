"""A motion tuned beside noise that is known: as likely as truth, as calm as truth, and free of what disturbs it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.autoregressive import ColouredNoise
from becalm.core.model.components import ORDERS, motion
from becalm.errors import ModelError, RecordingError
from becalm.identification.coloured import UNSCORED, score_coloured
from becalm.identification.cross_validation import simplest, stretches_for_spectra, tune_smoother
from becalm.identification.known_noise import _tune_with_white, log_prediction_error, tune_with_known_noise
from becalm.identification.likelihood import Evidence, Tuning, tune_motion
from becalm.metrics.truth import rms_error

SETTLING = 100


@cache
def moved(order: int, density: float, rows: int, seed: int) -> Floats:
    """Draw a motion, (rows,)."""
    model, rng = motion(order, density).to_model(1.0, 1.0), np.random.default_rng([seed, order])
    drive = rng.normal(size=(rows, order)) @ np.linalg.cholesky(model.process_covariance).T
    x, truth = np.zeros(order), np.empty(rows)
    for k in range(rows):
        truth[k], x = x[0], model.F @ x + drive[k]
    return truth


def red(rows: int, seed: int) -> Floats:
    """Draw noise of order 1, phi 0.9 and variance 1."""
    drive = np.sqrt(1 - 0.81) * np.random.default_rng([seed, 9]).normal(size=rows + 500)
    return np.asarray(lfilter([1.0], [1.0, -0.9], drive)[500:])


def white(rows: int, seed: int) -> Floats:
    return np.random.default_rng([seed, 7]).normal(size=rows)


def even(z: Floats) -> Evidence:
    return Evidence.of(z, np.ones(len(z)))


def error_of(tuning: Tuning, z: Floats, truth: Floats, causal: bool) -> float:
    """The rms error of the motion alone, the disturbance not in it."""
    component = tuning.component
    model = component.to_model(1.0, tuning.noise_variance)
    mean = (kalman_filter if causal else kalman_smoother)(model, z, states=True).mean
    assert mean is not None
    return rms_error((mean @ component.signal_output[0])[SETTLING:], truth[SETTLING:])


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("order", ORDERS)
def test_the_motion_is_found_beside_white_noise(order: int, causal: bool) -> None:
    """Over five records of 10 000 readings: the cut-off of the motion that was drawn, and its order."""
    density, orders, cutoffs = cutoff_to_ratio(order, 0.1), [], []
    for seed in range(5):
        z = moved(order, density, 10_000, seed) + white(10_000, seed)
        found = tune_with_known_noise(even(z), 1.0, causal=causal)
        assert found.noise_variance == 1.0
        assert found.coloured is None
        assert found.at_edge == ""
        orders.append(found.order)
        cutoffs.append(np.log(found.ratio) / (2 * found.order))
    assert orders.count(order) >= (5 if causal else 4)
    scatter = np.std(cutoffs, ddof=1)
    assert scatter < 0.1
    assert abs(np.mean(cutoffs) - np.log(0.1)) < 4 * max(scatter / np.sqrt(5), 0.01)


def test_a_known_variance_makes_the_density_no_less_certain() -> None:
    """Short records of a walking slope: the scatter of its log cut-off, R known and R found."""
    density, known, free = cutoff_to_ratio(2, 0.3), [], []
    for seed in range(30):
        z = moved(2, density, 200, seed) + white(200, seed)
        known.append(np.log(_tune_with_white(2, even(z), 1.0).ratio) / 4)
        free.append(np.log(tune_motion(2, even(z)).ratio) / 4)
    assert np.std(known) < np.std(free)
    assert abs(np.mean(known) - np.log(0.3)) < 4 * np.std(known) / np.sqrt(30)


@pytest.mark.parametrize("order", ORDERS)
def test_it_is_the_maximum_of_the_filters_likelihood(order: int) -> None:
    z = moved(order, cutoff_to_ratio(order, 0.2), 2000, 3) + white(2000, 3)
    found = tune_with_known_noise(even(z), 1.0, causal=True)

    def likelihood(ratio: float) -> float:
        run = kalman_filter(motion(found.order, ratio).to_model(1.0, 1.0), z)
        nu, S = run.innovations[3:, 0], run.innovation_sigma[3:, 0] ** 2
        return float(-0.5 * np.sum(nu**2 / S + np.log(2 * np.pi * S)))

    assert found.log_likelihood == pytest.approx(likelihood(found.ratio), rel=1e-9)
    for factor in np.geomspace(1e-3, 1e3, 25):
        assert likelihood(found.ratio * factor) <= found.log_likelihood + 0.01


@pytest.mark.parametrize("rows", [300, 6000])
def test_a_sine_is_smoothed_no_worse_for_knowing_the_noise(rows: int) -> None:
    """On average over eight records, against the same without knowing it."""
    truth = np.sin(0.05 * np.arange(rows))
    known, found = [], []
    for seed in range(8):
        z = truth + 0.3 * white(rows, seed)
        known.append(error_of(tune_with_known_noise(even(z), 0.09, causal=False), z, truth, causal=False))
        found.append(error_of(simplest(tune_smoother(even(z))), z, truth, causal=False))
    assert np.mean(known) <= 1.005 * np.mean(found)


def test_both_roads_of_a_smoother_lead_to_the_same_motion() -> None:
    z = np.sin(0.05 * np.arange(6000)) + 0.3 * white(6000, 1)
    elapsed = np.where(np.arange(6000) % 1000 == 500, 1.021, 1.0)  # beyond jitter
    whole, singly = even(z), Evidence.of(z, elapsed)
    assert stretches_for_spectra(whole)
    assert not stretches_for_spectra(singly)
    near, far = (tune_with_known_noise(evidence, 0.09, causal=False) for evidence in (whole, singly))
    assert near.order == far.order
    assert near.loss == pytest.approx(far.loss, abs=2e-3)
    assert np.log(near.ratio / far.ratio) == pytest.approx(0.0, abs=2 * near.order * 0.05)


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_a_motion_in_coloured_noise_is_a_fifth_nearer_than_as_if_white(seed: int, causal: bool) -> None:
    truth = moved(2, 0.02**4, 5000, seed)
    z = truth + red(5000, seed) + 0.3 * white(5000, seed)
    coloured = tune_with_known_noise(even(z), 0.09, ColouredNoise((0.9,), 1.0), causal=causal)
    plain = tune_with_known_noise(even(z), 1.09, causal=causal)
    assert coloured.order == 2
    assert coloured.coloured == ColouredNoise((0.9,), 1.0)
    assert np.log(coloured.ratio * 0.09 / 0.02**4) == pytest.approx(0.0, abs=1.2)
    assert error_of(coloured, z, truth, causal) < 0.8 * error_of(plain, z, truth, causal)


def test_a_long_record_beside_coloured_noise_is_tuned_on_some_of_it() -> None:
    truth = moved(2, 0.02**4, 100_000, 5)
    z = truth + red(100_000, 5) + 0.3 * white(100_000, 5)
    found = tune_with_known_noise(even(z), 0.09, ColouredNoise((0.9,), 1.0), causal=True)
    assert found.count == 16 * (2048 - UNSCORED)
    assert found.order == 2
    assert np.log(found.ratio * 0.09 / 0.02**4) == pytest.approx(0.0, abs=0.4)


def test_missing_readings_are_steps_all_the_same() -> None:
    truth = moved(2, 0.02**4, 5000, 1)
    z = truth + red(5000, 1) + 0.3 * white(5000, 1)
    z[np.random.default_rng(1).random(5000) < 0.2] = np.nan
    z[2000:2300] = np.nan
    found = tune_with_known_noise(even(z), 0.09, ColouredNoise((0.9,), 1.0), causal=False)
    assert found.order == 2
    assert np.log(found.ratio * 0.09 / 0.02**4) == pytest.approx(0.0, abs=1.2)


def test_the_likelihood_in_coloured_noise_is_one_joint_gaussian() -> None:
    """A walk of unknown level: of all readings but the first, given these, by their covariances."""
    rows, q, R = 40, 0.05, 0.2
    z = np.cumsum(np.sqrt(q) * white(rows, 2)) + red(rows, 2) + np.sqrt(R) * white(rows, 3)
    tuning = Tuning(1, q / R, R, 0, coloured=ColouredNoise((0.9,), 1.0))
    told = score_coloured(tuning.component, R, z[:, np.newaxis], np.ones(rows))
    assert told is not None
    k = np.arange(rows)
    S = q * np.minimum.outer(k, k) + 0.9 ** np.abs(np.subtract.outer(k, k)) + R * np.eye(rows)

    def minus_twice(n: int) -> float:
        """Of the first n readings, the level integrated out, but for constants."""
        one, inverse = np.ones(n), np.linalg.inv(S[:n, :n])
        information = one @ inverse @ one
        squares = z[:n] @ inverse @ z[:n] - (one @ inverse @ z[:n]) ** 2 / information
        return float(squares + np.linalg.slogdet(S[:n, :n])[1] + np.log(information))

    assert told.used == rows - UNSCORED
    assert told.squares + told.log_det == pytest.approx(minus_twice(rows) - minus_twice(UNSCORED), rel=1e-9)


def test_the_foretold_square_weighs_residual_and_freedom() -> None:
    assert log_prediction_error(1.0, 0.1, 1000, 1.0) < log_prediction_error(1.1, 0.1, 1000, 1.0)
    assert log_prediction_error(1.0, 0.1, 1000, 1.0) < log_prediction_error(1.0, 0.2, 1000, 1.0)
    assert log_prediction_error(1.0, 0.1, 100, 1.0) > log_prediction_error(1.0, 0.1, 1000, 1.0)
    assert np.exp(log_prediction_error(0.8, 0.1, 10**12, 1.0)) == pytest.approx(
        1.0, rel=1e-5
    )  # as of an unbiased 0.8 + 2 g R


@pytest.mark.parametrize("rows", [8, 9, 12, 40])
@pytest.mark.parametrize("noise", [None, ColouredNoise((0.5,), 0.5)])
@pytest.mark.parametrize("causal", [True, False])
def test_short_records_are_tuned(rows: int, noise: ColouredNoise | None, causal: bool) -> None:
    found = tune_with_known_noise(even(white(rows, rows)), 1.0, noise, causal=causal)
    assert found.order in (1, 2, 3, 4, 5)
    assert 0 < found.ratio < np.inf


@pytest.mark.parametrize(
    ("rows", "noise", "causal"),
    [(1, None, True), (2, None, False), (1, ColouredNoise((0.9,), 1.0), False), (2, ColouredNoise((0.9,), 1.0), True)],
)
def test_stretches_that_tell_no_motion_are_refused(rows: int, noise: ColouredNoise | None, causal: bool) -> None:
    """Readings one by one and in pairs; without a warning of arithmetic on the way."""
    parted = Evidence.of(white(50, 1), np.where(np.arange(50) % rows == 0, 1e4, 1.0))
    with pytest.raises(RecordingError, match=r"^No stretch of the record is long enough"):
        tune_with_known_noise(parted, 1.0, noise, causal=causal)


def test_short_stretches_tell_what_they_can() -> None:
    """Four readings in a row tell a smoother of the lower orders, and a filter one scored reading each."""
    parted = Evidence.of(white(400, 1), np.where(np.arange(400) % 8 == 0, 1e4, 1.0))
    for causal in (True, False):
        assert tune_with_known_noise(parted, 1.0, causal=causal).count in (400, 50 * 5)


def test_what_cannot_be_tuned_is_refused() -> None:
    with pytest.raises(RecordingError, match=r"^7 readings came; 8 or more are needed for a motion"):
        tune_with_known_noise(even(np.arange(7.0)), 1.0, causal=True)
    stamped = Evidence.of(white(50, 1), np.random.default_rng(1).uniform(0.5, 1.5, 50))
    with pytest.raises(ModelError, match=r"not a whole number of steps"):
        tune_with_known_noise(stamped, 1.0, ColouredNoise((0.9,), 1.0), causal=True)
