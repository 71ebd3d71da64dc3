"""Oracles of the steady filter and smoother: Riccati, penalised least squares, spectrum, filtfilt."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.signal import butter, sosfiltfilt

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import motion
from becalm.core.model.model import Model
from becalm.core.steady.response import describe
from becalm.core.steady.steady_filter import steady
from becalm.errors import ModelError

SETTLED: dict[str, dict[str, Any]] = {
    "level": {"F": [[1]], "H": [[1]], "Q": [[0.04]], "R": [[0.7]]},
    "slope": {"F": [[1, 0.1], [0, 1]], "H": [[1, 0]], "Q": [[1e-4, 0], [0, 0.1]], "R": [[2]]},
    "slope, Q of rank one": {"F": [[1, 1], [0, 1]], "H": [[1, 0]], "G": [[0.5], [1]], "Q": [[0.05]], "R": [[1]]},
    "damped rotation": {"F": [[0.9, -0.3], [0.3, 0.9]], "H": [[1, 0.2]], "Q": 0.1 * np.eye(2), "R": [[0.5]]},
    "acceleration": {
        "F": [[1, 1, 0.5], [0, 1, 1], [0, 0, 1]],
        "H": [[1, 0, 0]],
        "G": [[0], [0], [1]],
        "Q": [[0.01]],
        "R": [[1]],
    },
    "two channels, R correlated": {
        "F": [[1, 0.5], [0, 0.9]],
        "H": [[1, 0], [0.5, 1]],
        "Q": [[0.3, 0.1], [0.1, 0.2]],
        "R": [[1.0, 0.6], [0.6, 2.0]],
    },
}


def differencing(order: int, ratio: float) -> Model:
    """A model whose n-th difference of the level is white: noise enters the last state alone."""
    last = np.zeros((order, 1))
    last[-1] = 1
    return Model(F=np.eye(order) + np.eye(order, k=1), H=np.eye(1, order), G=last, Q=[[ratio]], R=[[1]])


def spectrum(model: Model, cycles: Floats) -> Floats:
    """Power density of the signal H x, (k,), at `cycles` a step, none of them 0."""
    turn = np.exp(2j * np.pi * cycles)[:, np.newaxis, np.newaxis]
    reach = np.linalg.inv(turn * np.eye(model.states) - model.F)
    through = model.H @ reach
    power: Floats = (through @ model.process_covariance @ np.conj(np.swapaxes(through, 1, 2)))[:, 0, 0].real
    return power


@pytest.mark.parametrize("name", SETTLED)
def test_the_covariance_settles_at_the_riccati_equations(name: str) -> None:
    model = Model(**SETTLED[name])
    cov = kalman_filter(model, np.zeros((3000, model.channels)), covariances=True).cov
    assert cov is not None
    predicted = model.F @ cov[-1] @ model.F.T + model.process_covariance
    expected = solve_discrete_are(model.F.T, model.H.T, model.process_covariance, model.R)
    np.testing.assert_allclose(predicted, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("name", [name for name in SETTLED if "channels" not in name])
def test_doubling_solves_the_riccati_equation(name: str) -> None:
    model = Model(**SETTLED[name])
    expected = solve_discrete_are(model.F.T, model.H.T, model.process_covariance, model.R)
    found = steady(model)
    np.testing.assert_allclose(found.predicted_cov, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    assert found.innovation_variance == pytest.approx((model.H @ expected @ model.H.T + model.R).item(), rel=1e-10)
    assert np.abs(np.linalg.eigvals(found.closed_loop)).max() < 1


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("cutoff", [1e-3, 1e-2, 0.3])
def test_doubling_keeps_the_riccati_equation_at_small_cutoffs(order: int, cutoff: float) -> None:
    """The residual of the equation itself, where eigenvalue methods fail, in states of equal size."""
    model = motion(order, cutoff ** (2 * order)).to_model(1.0, 1.0)
    P = steady(model).predicted_cov
    K = P @ model.H.T / ((model.H @ P @ model.H.T).item() + 1)
    A = np.eye(order) - K @ model.H
    again = model.F @ (A @ P @ A.T + K @ K.T) @ model.F.T + model.process_covariance
    scale = 1 / np.sqrt(np.diag(P))
    assert np.abs((again - P) * np.outer(scale, scale)).max() < 1e-9


@pytest.mark.parametrize(("order", "cutoff"), [(1, 0.1), (1, 1.0), (2, 0.1), (2, 0.5), (3, 0.1), (3, 0.5)])
def test_the_smoother_with_a_flat_start_is_penalised_least_squares(order: int, cutoff: float) -> None:
    ratio, count = cutoff ** (2 * order), 200
    z = np.cumsum(np.random.default_rng(order).normal(size=count))
    D = np.diff(np.eye(count), n=order, axis=0)
    Q, triangle = np.linalg.qr(np.vstack([np.eye(count), D / np.sqrt(ratio)]))
    expected = np.linalg.solve(triangle, Q[:count].T @ z)  # (I + (R/q) D'D)^-1 z
    inverse = np.linalg.inv(triangle)
    got = kalman_smoother(differencing(order, ratio), z)
    assert np.abs(got.signal[:, 0] - expected).max() < 1e-8 * np.abs(z).max()
    np.testing.assert_allclose(got.sigma[:, 0] ** 2, np.sum(inverse**2, axis=1), rtol=1e-5)


@pytest.mark.parametrize(
    "model",
    [differencing(1, 0.01), differencing(2, 1e-3), differencing(3, 1e-3)]
    + [motion(order, 0.2 ** (2 * order)).to_model(1.0, 1.0) for order in (1, 2, 3)],
    ids=["difference 1", "difference 2", "difference 3", "motion 1", "motion 2", "motion 3"],
)
def test_the_smoother_in_mid_record_is_the_wiener_filter(model: Model) -> None:
    """An impulse in mid-record comes out with the spectrum S / (S + R)."""
    count = 2001
    z = np.zeros(count)
    z[count // 2] = 1.0
    passed = kalman_smoother(model, z).signal[:, 0]
    cycles = np.arange(1, count // 2) / count
    gain = np.fft.rfft(np.roll(passed, -(count // 2)))[1 : count // 2]
    S = spectrum(model, cycles)
    assert np.abs(gain - S / (S + 1.0)).max() < 1e-12


@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_described_powers_are_those_of_the_filter_and_smoother(order: int) -> None:
    model = motion(order, 0.2 ** (2 * order)).to_model(1.0, 1.0)
    cycles = np.linspace(0.01, 0.5, 50)
    S = spectrum(model, cycles)
    np.testing.assert_allclose(steady(model).smoother_power(cycles), (S / (S + 1)) ** 2, rtol=1e-9, atol=1e-12)
    z = np.zeros(4096)
    z[2048] = 1.0
    passed = kalman_filter(model, z).signal[2048:, 0]
    heard = np.abs(np.exp(-2j * np.pi * np.outer(cycles, np.arange(2048))) @ passed) ** 2
    np.testing.assert_allclose(steady(model).filter_power(cycles), heard, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_the_smoother_is_a_zero_phase_butterworth(order: int) -> None:
    """At fs / f0 = 100 the gains differ by less than a thousandth at every frequency; both are linear."""
    count = 6001
    z = np.zeros(count)
    z[count // 2] = 1.0
    model = motion(order, (2 * np.pi / 100) ** (2 * order)).to_model(1.0, 1.0)
    got = kalman_smoother(model, z).signal[:, 0]
    expected = sosfiltfilt(butter(order, 2 / 100, output="sos"), z)
    assert np.abs(got - expected).max() < 1e-3
    assert np.abs(np.fft.rfft(got) - np.fft.rfft(expected)).max() < 1e-3


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_described_noise_gain_is_what_noise_loses(order: int, causal: bool) -> None:
    """The noise gain is the sum of the squares of the impulse response in mid-record."""
    model = motion(order, 0.1 ** (2 * order)).to_model(1.0, 1.0)
    z = np.zeros(4001)
    z[2000] = 1.0
    passed = (kalman_filter if causal else kalman_smoother)(model, z).signal[:, 0]
    kept = passed[2000:] if causal else passed
    assert describe(model, 0.01, causal).noise_gain == pytest.approx(float(kept @ kept), rel=1e-4)


def test_a_response_is_refused_where_there_is_none() -> None:
    two = Model(F=[[1]], H=[[1], [1]], Q=[[1]], R=np.eye(2))
    exact = Model(F=[[1]], H=[[1]], Q=[[1]], R=[[0]], x0=[0], P0=[[1]])
    constant = Model(F=[[1]], H=[[1]], Q=[[0]], R=[[1]])
    for model, word in ((two, "this model has 2"), (exact, "R = 0"), (constant, "no steady state")):
        with pytest.raises(ModelError, match=word):
            describe(model, 1.0)
