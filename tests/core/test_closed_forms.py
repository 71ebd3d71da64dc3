"""Closed forms of the one-, two- and three-state filters, and the table of motions of any order."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import motion
from becalm.core.model.model import Model
from becalm.core.steady.response import describe
from becalm.core.steady.steady_filter import SteadyFilter, steady

CLOSED = 1e-10
SIX_DIGITS = 5e-6  # of numbers printed with six
LAMBDAS = [1e-6, 1e-3, 0.1, 2.0]


def random_walk(ratio: float, r: float = 1.0) -> Model:
    return Model(F=[[1]], H=[[1]], Q=[[ratio * r]], R=[[r]])


def gains(found: SteadyFilter) -> Floats:
    return found.gain[:, 0]


def filtered_cov(found: SteadyFilter) -> Floats:
    A = np.eye(found.model.states) - found.gain @ found.model.H
    return A @ found.predicted_cov


@pytest.mark.parametrize("ratio", LAMBDAS)
@pytest.mark.parametrize("r", [1.0, 4e-6])
def test_the_random_walk_filter_has_its_closed_form(ratio: float, r: float) -> None:
    K = (-ratio + np.sqrt(ratio**2 + 4 * ratio)) / 2
    found = steady(random_walk(ratio, r))
    assert gains(found).item() == pytest.approx(K, rel=CLOSED)
    assert ratio == pytest.approx(K**2 / (1 - K), rel=CLOSED)
    assert filtered_cov(found).item() == pytest.approx(K * r, rel=CLOSED)
    assert found.predicted_cov.item() == pytest.approx(K * r / (1 - K), rel=CLOSED)
    assert found.innovation_variance == pytest.approx(r / (1 - K), rel=CLOSED)


@pytest.mark.parametrize("ratio", LAMBDAS)
def test_the_random_walk_kernel_settles_at_its_closed_form(ratio: float) -> None:
    K = (-ratio + np.sqrt(ratio**2 + 4 * ratio)) / 2
    z = np.zeros(40_000)
    z[-1] = 1.0
    got = kalman_filter(random_walk(ratio), z)
    assert got.sigma[-1, 0] ** 2 == pytest.approx(K, rel=CLOSED)
    assert got.innovation_sigma[-1, 0] ** 2 == pytest.approx(1 / (1 - K), rel=CLOSED)
    assert got.signal[-1, 0] == pytest.approx(K, rel=CLOSED)


@pytest.mark.parametrize("ratio", LAMBDAS)
def test_the_random_walk_filter_is_described_by_its_closed_form(ratio: float) -> None:
    K = (-ratio + np.sqrt(ratio**2 + 4 * ratio)) / 2
    told = describe(random_walk(ratio), step_s=0.02)
    assert told.noise_gain == pytest.approx(K / (2 - K), rel=CLOSED)
    assert told.lag_s == pytest.approx(0.02 * (1 - K) / K, rel=CLOSED)
    assert 4 * np.sin(np.pi * told.bandwidth_hz * 0.02) ** 2 == pytest.approx(ratio, rel=CLOSED)


@pytest.mark.parametrize("cutoff_hz", [0.016, 1.0, 7.0])
def test_the_dial_from_cutoff_to_ratio_is_exact(cutoff_hz: float) -> None:
    ratio = 4 * np.sin(np.pi * cutoff_hz / 50) ** 2
    assert describe(random_walk(ratio), 1 / 50).bandwidth_hz == pytest.approx(cutoff_hz, rel=CLOSED)
    assert steady(random_walk(ratio)).filter_power(np.array([cutoff_hz / 50])).item() == pytest.approx(0.5, rel=CLOSED)


@pytest.mark.parametrize(
    ("fs", "enbw", "bandwidth", "delay_s"),
    [(50, 0.025, 0.016, 10.0), (500, 0.25, 0.159, 1.0), (10_000, 5.0, 3.18, 0.05)],
)
def test_thirty_decibels_cost_what_the_table_says(fs: float, enbw: float, bandwidth: float, delay_s: float) -> None:
    K = 2 / 1001  # K / (2 - K) = 1 / 1000
    told = describe(random_walk(K**2 / (1 - K)), 1 / fs)
    assert told.noise_gain == pytest.approx(1e-3, rel=CLOSED)
    assert fs / 2 * told.noise_gain == pytest.approx(enbw, rel=CLOSED)
    assert told.bandwidth_hz == pytest.approx(bandwidth, rel=0.01)
    assert told.lag_s == pytest.approx(delay_s, rel=0.01)


def alpha_beta(index: float, T: float = 1.0, r: float = 1.0) -> Model:
    """Piecewise constant acceleration: Q of rank one, through G."""
    return Model(F=np.array([[1, T], [0, 1]]), H=[[1, 0]], G=[[T**2 / 2], [T]], Q=[[(index / T**2) ** 2 * r]], R=[[r]])


INDICES = [1e-3, 0.05, 0.5, 3.0]
PRINTED = [(0.0437352, 0.000977888), (0.270867, 0.0426946), (0.628373, 0.304806), (0.901492, 0.941578)]


@pytest.mark.parametrize(("index", "printed"), list(zip(INDICES, PRINTED, strict=True)))
@pytest.mark.parametrize("T", [1.0, 0.01])
def test_alpha_beta_of_kalata(index: float, printed: tuple[float, float], T: float) -> None:
    root = (4 + index - np.sqrt(8 * index + index**2)) / 4
    alpha, beta = 1 - root**2, 2 * (1 - root) ** 2
    r = 0.25
    found = steady(alpha_beta(index, T, r))
    np.testing.assert_allclose(gains(found) * [1, T], [alpha, beta], rtol=CLOSED)
    np.testing.assert_allclose(gains(found) * [1, T], printed, rtol=SIX_DIGITS)
    corner = beta * (alpha - beta / 2) / ((1 - alpha) * T**2)
    np.testing.assert_allclose(filtered_cov(found) / r, [[alpha, beta / T], [beta / T, corner]], rtol=CLOSED)
    assert found.innovation_variance == pytest.approx(r / (1 - alpha), rel=CLOSED)
    assert beta**2 / (1 - alpha) == pytest.approx(index**2, rel=CLOSED)


@pytest.mark.parametrize("index", INDICES)
def test_alpha_beta_noise_gain_and_lag(index: float) -> None:
    model = alpha_beta(index)
    a, b = gains(steady(model))
    told = describe(model, 1.0)
    assert told.noise_gain == pytest.approx((2 * a**2 + 2 * b - 3 * a * b) / (a * (4 - 2 * a - b)), rel=CLOSED)
    assert told.dc_delay_s == pytest.approx(0.0, abs=1e-9)


def test_alpha_beta_lags_a_constant_acceleration_as_printed() -> None:
    model = alpha_beta(0.5)
    a, b = gains(steady(model))
    t = np.arange(400.0)
    got = kalman_filter(model, t**2 / 2, states=True)
    assert got.mean is not None
    assert t[-1] ** 2 / 2 - got.mean[-1, 0] == pytest.approx((1 - a) / b, rel=1e-9)
    assert t[-1] - got.mean[-1, 1] == pytest.approx((2 * a - b) / (2 * b), rel=1e-9)


@pytest.mark.parametrize("index", INDICES)
def test_alpha_beta_of_continuous_white_acceleration(index: float) -> None:
    T, r = 0.1, 0.3
    found = steady(motion(2, index**2 * r / T**3).to_model(T, r))
    alpha, beta = gains(found) * [1, T]
    assert beta == pytest.approx(3 * (2 - alpha) - np.sqrt(3 * (alpha**2 - 12 * alpha + 12)), rel=1e-8)
    assert beta**2 / (1 - alpha) == pytest.approx(index**2, rel=CLOSED)
    if index == 0.5:
        np.testing.assert_allclose([alpha, beta], [0.632085, 0.303280], rtol=SIX_DIGITS)


@pytest.mark.parametrize("T", [1.0, 0.1])
def test_alpha_beta_gamma(T: float) -> None:
    index, r = 0.05, 2.0
    F = np.array([[1, T, T**2 / 2], [0, 1, T], [0, 0, 1]])
    G = np.array([[T**2 / 2], [T], [1]])
    model = Model(F=F, H=[[1, 0, 0]], G=G, Q=[[(index / T**2) ** 2 * r]], R=[[r]])
    a, b, g = gains(steady(model)) * [1, T, 2 * T**2]
    np.testing.assert_allclose([a, b, g], [0.521351, 0.189919, 0.0691845], rtol=SIX_DIGITS)
    assert g == pytest.approx(b**2 / a, rel=CLOSED)
    assert b == pytest.approx(2 * (2 - a) - 4 * np.sqrt(1 - a), rel=CLOSED)
    assert g**2 / (4 * (1 - a)) == pytest.approx(index**2, rel=CLOSED)
    simpson = g / 2
    above = 2 * b * (2 * a**2 + 2 * b - 3 * a * b) - a * simpson * (4 - 2 * a - b)
    noise_gain = above / ((4 - 2 * a - b) * (2 * a * b + a * simpson - 2 * simpson))
    assert describe(model, T).noise_gain == pytest.approx(noise_gain, rel=CLOSED)
    assert noise_gain == pytest.approx(0.462580, rel=SIX_DIGITS)


# order: ENBW, -3 dB, peak (dB), overshoot, P_filter; all of section 3.6, in units of w_n
MOTIONS = [
    (1, 0.25, 1.000, 0.0, 0.0, 1.0),
    (2, 0.530, 2.058, 2.09, 0.208, 1.414),
    (3, 0.833, 2.831, 3.99, 0.309, 2.0),
]
SLOW = 0.01  # w_n in radians a step: nearly continuous
LIMIT = 0.02


@pytest.mark.parametrize(("order", "enbw", "bandwidth", "peak_db", "overshoot", "variance"), MOTIONS)
class TestMotionsNearTheContinuousLimit:
    def test_noise_bandwidth_and_peak(  # noqa: PLR0913  (one row of the table)
        self, order: int, enbw: float, bandwidth: float, peak_db: float, overshoot: float, variance: float
    ) -> None:
        model = motion(order, SLOW ** (2 * order)).to_model(1.0, 1.0)
        told = describe(model, 1.0)
        assert told.noise_gain / 2 == pytest.approx(enbw * SLOW, rel=LIMIT)
        assert 2 * np.pi * told.bandwidth_hz == pytest.approx(bandwidth * SLOW, rel=LIMIT)
        power = steady(model).filter_power(np.geomspace(1e-6, 0.5, 4000))
        assert 10 * np.log10(power.max()) == pytest.approx(peak_db, rel=LIMIT, abs=1e-5)
        lag = 1 / SLOW if order == 1 else 0.0
        assert told.dc_delay_s == pytest.approx(lag, rel=LIMIT, abs=1e-3)

    def test_overshoot_of_a_step(  # noqa: PLR0913
        self, order: int, enbw: float, bandwidth: float, peak_db: float, overshoot: float, variance: float
    ) -> None:
        z = np.repeat([0.0, 1.0], 6000)
        signal = kalman_filter(motion(order, SLOW ** (2 * order)).to_model(1.0, 1.0), z).signal
        assert signal.max() - 1 == pytest.approx(overshoot, rel=LIMIT, abs=1e-9)
        assert signal[-1, 0] == pytest.approx(1.0, abs=1e-6)

    def test_variance_of_filter_and_smoother(  # noqa: PLR0913
        self, order: int, enbw: float, bandwidth: float, peak_db: float, overshoot: float, variance: float
    ) -> None:
        model = motion(order, SLOW ** (2 * order)).to_model(1.0, 1.0)
        z = np.zeros(6000)
        filtered = kalman_filter(model, z).sigma[-1, 0] ** 2
        assert filtered == pytest.approx(variance * SLOW, rel=LIMIT)
        assert filtered == pytest.approx(SLOW / np.sin(np.pi / (2 * order)), rel=LIMIT)
        smoothed = kalman_smoother(model, z).sigma[3000, 0] ** 2
        assert smoothed == pytest.approx(variance * SLOW / (2 * order), rel=LIMIT)

    def test_the_smoother_keeps_half_of_the_amplitude_at_its_cutoff(  # noqa: PLR0913
        self, order: int, enbw: float, bandwidth: float, peak_db: float, overshoot: float, variance: float
    ) -> None:
        model = motion(order, SLOW ** (2 * order)).to_model(1.0, 1.0)
        assert steady(model).smoother_power(np.array([SLOW / (2 * np.pi)])).item() == pytest.approx(0.25, rel=LIMIT)
        gain = (np.sqrt(2) - 1) ** (1 / (2 * order))  # of 1 / (1 + w^2n) = 1 / sqrt(2)
        told = describe(model, 1.0, causal=False)
        assert 2 * np.pi * told.bandwidth_hz == pytest.approx(gain * SLOW, rel=LIMIT)
        assert told.lag_s == 0.0
