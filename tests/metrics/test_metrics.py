"""Metrics: whiteness, what is still predictable, evenness, and the measures that know the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.stats import chi2, kstest

from becalm.core.arrays import Floats
from becalm.metrics.truth import coverage, rms_error
from becalm.metrics.whiteness import LAGS, LaggedSums, mean_nis, predictors, uneven_share, whiteness


def white(rows: int, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).normal(size=rows)


def autoregressive(phi: float, rows: int, seed: int = 1) -> Floats:
    coloured: Floats = lfilter([1.0], [1.0, -phi], white(rows + 200, seed))[200:]
    return coloured


def autocorrelation(e: Floats, lags: int) -> Floats:
    about = LaggedSums().extended(e).about_mean(lags)
    correlation: Floats = about / about[0]
    return correlation


def test_ljung_box_gives_white_noise_uniform_p_values() -> None:
    p = [whiteness(white(2000, seed)).p_value for seed in range(1000)]
    assert kstest(p, "uniform").pvalue > 0.01
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=0.02)


def test_ljung_box_is_its_formula() -> None:
    e = autoregressive(0.05, 800)
    centred = e - e.mean()
    rho = np.correlate(centred, centred, "full")[len(e) - 1 :] / (centred @ centred)
    statistic = len(e) * (len(e) + 2) * sum(rho[j] ** 2 / (len(e) - j) for j in range(1, LAGS + 1))
    found = whiteness(e)
    assert found.p_value == pytest.approx(chi2.sf(statistic, LAGS), rel=1e-9)
    assert found.first_correlation == pytest.approx(rho[1], rel=1e-12)
    np.testing.assert_allclose(autocorrelation(e, 30), rho[:31], rtol=1e-10, atol=1e-14)


def test_nothing_of_white_noise_is_predictable() -> None:
    shares = [whiteness(white(5000, seed)).predictable_share for seed in range(50)]
    assert max(shares) < 0.01
    assert np.mean(shares) < 0.003


@pytest.mark.parametrize("phi", [-0.9, -0.3, 0.2, 0.5, 0.8, 0.95])
def test_the_square_of_phi_is_predictable_of_an_autoregression(phi: float) -> None:
    found = whiteness(autoregressive(phi, 100_000))
    assert found.predictable_share == pytest.approx(phi**2, abs=0.01)
    assert found.first_correlation == pytest.approx(phi, abs=0.01)
    assert found.p_value < 1e-6


@pytest.mark.parametrize("rows", [300, 1000])
@pytest.mark.parametrize("phi", [0.0, 0.5])
def test_chance_is_taken_off_short_records(rows: int, phi: float) -> None:
    shares = [whiteness(autoregressive(phi, rows, seed)).predictable_share for seed in range(200)]
    assert np.mean(shares) == pytest.approx(phi**2, abs=0.03)


def test_durbin_solves_the_normal_equations() -> None:
    rho = autocorrelation(autoregressive(0.7, 3000), 12)
    expected = solve_toeplitz(rho[:-1], rho[1:])
    *_, found = predictors(rho)
    np.testing.assert_allclose(found.coefficients, expected, rtol=1e-8, atol=1e-12)
    assert found.error == pytest.approx(float(1 - expected @ rho[1:]), rel=1e-10)


def test_a_predictor_has_as_many_lags_as_pay() -> None:
    assert all(len(whiteness(white(5000, seed)).predictor.coefficients) == 0 for seed in range(20))
    found = whiteness(autoregressive(0.8, 20_000)).predictor
    np.testing.assert_allclose(found.coefficients, [0.8], atol=0.02)
    angle = np.linspace(0, np.pi, 2001)
    np.testing.assert_allclose(found.power(angle), 0.36 / np.abs(1 - 0.8 * np.exp(-1j * angle)) ** 2, rtol=0.15)
    assert np.trapezoid(found.power(angle), angle) / np.pi == pytest.approx(1.0, rel=1e-6)


def test_a_tone_is_predictable_nearly_all() -> None:
    found = whiteness(np.sin(0.3 * np.arange(20_000)) + 1e-3 * white(20_000))
    assert 0.99 < found.predictable_share <= 1.0
    assert found.p_value < 1e-6


def test_scale_and_shift_do_not_matter_to_whiteness() -> None:
    e = autoregressive(0.3, 4000)
    found, other = whiteness(e), whiteness(1e6 * e - 40)
    assert other.p_value == pytest.approx(found.p_value, rel=1e-6)
    assert other.predictable_share == pytest.approx(found.predictable_share, rel=1e-9)
    assert whiteness(-e).first_correlation == pytest.approx(found.first_correlation, rel=1e-12)


@pytest.mark.parametrize("e", [np.empty(0), np.full(500, np.nan), np.zeros(500), np.full(500, 0.1), white(7)], ids=str)
def test_where_nothing_can_be_told_nothing_is_claimed(e: Floats) -> None:
    found = whiteness(e)
    assert (found.p_value, found.first_correlation, found.predictable_share) == (1.0, 0.0, 0.0)


def test_nan_is_left_out() -> None:
    e = autoregressive(0.4, 3000)
    holed = np.insert(e, [0, 10, 500, 3000], np.nan)
    assert whiteness(holed) == whiteness(e)
    assert mean_nis(holed) == mean_nis(e)
    assert uneven_share(holed) == uneven_share(e)


def test_mean_nis_is_the_mean_square() -> None:
    assert mean_nis(np.array([1.0, -2.0, np.nan, 3.0])) == pytest.approx(14 / 3, rel=1e-15)
    assert np.isnan(mean_nis(np.full(3, np.nan)))
    assert np.isnan(mean_nis(np.empty(0)))
    assert mean_nis(white(100_000)) == pytest.approx(1.0, abs=0.02)


def test_chance_makes_no_block_uneven() -> None:
    assert uneven_share(white(500_000)) == 0.0


@pytest.mark.parametrize(("scale", "share"), [(1.0, 0.0), (1.4, 0.0), (3.0, 1.0), (0.3, 1.0)])
def test_a_sigma_that_is_off_makes_all_blocks_uneven(scale: float, share: float) -> None:
    assert uneven_share(scale * white(50_000)) == pytest.approx(share, abs=0.01)


def test_noise_that_changes_is_uneven_where_it_changed() -> None:
    e = white(10_000)
    e[5000:6000] *= 5
    assert uneven_share(e) == pytest.approx(0.1, abs=1e-12)
    assert uneven_share(e[:49]) == 0.0


def test_rms_error_and_coverage_by_hand() -> None:
    signal, sigma = np.array([0.0, 1.0, 2.0, np.nan]), np.array([1.0, 1.0, 1.0, np.inf])
    truth = np.array([0.5, 3.0, 2.0, 7.0])
    assert rms_error(signal, truth) == pytest.approx(np.sqrt((0.25 + 4) / 3), rel=1e-15)
    assert coverage(signal, sigma, truth) == pytest.approx(2 / 3, rel=1e-15)
    assert coverage(signal, sigma, np.array([0.5, np.nan, 2.0, 7.0])) == 1.0
    assert coverage(np.zeros(100_000), np.ones(100_000), white(100_000)) == pytest.approx(0.683, abs=0.01)
