"""Run the car paper's filter: its printed matrices, the one-step prediction of Appendix B, the steady-state gain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov

from becalm.core.arrays import Complexes, Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.model.covariances import covariance_ahead, gain_before
from becalm.core.model.model import Model
from becalm.core.reference import kalman as reference
from becalm.studies.drive import RATE_HZ

T = 1 / RATE_HZ  # step in seconds
CHECKED_GAIN = ((0.00199524, 0.00187742, 0.0), (0.00187742, 0.06124743, 0.0), (0.0, 0.0, 0.06127717))
"""Steady-state gain of the filtered form, computed from the printed matrices, independently of this code."""


def printed_model(known_start: bool = True) -> Model:
    """Return the model of speed, longitudinal and vertical acceleration with the matrices that the paper prints.

    Parameters
    ----------
    known_start : bool
        Whether to start from x0 and P0, as the paper does; otherwise the filter starts from the first readings.
    """
    F = ((1, T, 0), (0, 1, 0), (0, 0, 1))
    G = ((T**2 / 2, 0), (T, 0), (0, T))
    Q, R = 1e5 * np.eye(2), 100 * np.eye(3)
    if not known_start:
        return Model(F, np.eye(3), Q, R, G=G)
    return Model(F, np.eye(3), Q, R, G=G, x0=np.zeros(3), P0=np.diag([1000.0, 100.0, 100.0]))


def vertical_alone(model: Model) -> Model:
    """Return the part of the three-sensor model for the vertical acceleration; the other states do not affect it."""
    return Model(model.F[2:, 2:], [[1.0]], model.process_covariance[2:, 2:], model.R[2:, 2:])


class OneStep(NamedTuple):
    """The states and covariances of Appendix B over a record; N rows, n states."""

    ahead: Floats  # (N, n) predicted states x(n+1 | n)
    filtered_cov: Floats  # (N, n, n) filtered covariances P(n)
    ahead_cov: Floats  # (N, n, n) predicted covariances P(n+1, n)
    gain: Floats  # (n, m) gain K_G of the last step, which includes F


def run_one_step(model: Model, z: Floats) -> OneStep:
    """Filter readings z (N, m) in the one-step-prediction form of Appendix B, from x0 and P0."""
    assert model.x0 is not None
    assert model.P0 is not None
    estimate, steps = reference.StateEstimate(model.x0, model.P0), []
    for reading in z:
        step = reference.predict_one_step(estimate, model.F, model.process_covariance, (model.H, model.R), reading)
        estimate = reference.StateEstimate(step.state, step.cov)
        steps.append(step)
    return OneStep(
        np.array([step.state for step in steps]),
        np.array([step.filtered_cov for step in steps]),
        np.array([step.cov for step in steps]),
        steps[-1].gain,
    )


class FormDifferences(NamedTuple):
    """The largest relative differences between the one-step-prediction form and the filtered form."""

    state: float  # of x(n+1 | n), relative to the largest value of each state
    filtered_cov: float  # of P(n), relative to its largest entry in the same row
    ahead_cov: float  # of P(n+1, n), relative to its largest entry in the same row


def compare_forms(model: Model, z: Floats) -> FormDifferences:
    """Filter readings z (N, m) in both forms; compare x(n+1 | n) with F x(n | n), and the covariances."""
    one, got = run_one_step(model, z), kalman_filter(model, z, states=True, covariances=True)
    assert got.mean is not None
    assert got.cov is not None
    ahead, ahead_cov = got.mean @ model.F.T, covariance_ahead(got.cov, model)
    state = np.abs(one.ahead - ahead) / np.abs(one.ahead).max(axis=0)
    return FormDifferences(float(state.max()), _apart(one.filtered_cov, got.cov), _apart(one.ahead_cov, ahead_cov))


def _apart(P: Floats, other: Floats) -> float:
    return float((np.abs(P - other).max(axis=(1, 2)) / np.abs(P).max(axis=(1, 2))).max())


def settled_gain(model: Model) -> Floats:
    """Return the steady-state gain (n, m) of the filtered form, from the Riccati equation."""
    P = solve_discrete_are(model.F.T, model.H.T, model.process_covariance, model.R)
    return gain_before(np.asarray(P, dtype=np.float64), model)


def computed_noise_gain(model: Model) -> Floats:
    """Return the noise gain (m,) in steady state: output over input power, for equal white noise on all channels."""
    K = settled_gain(model)
    A = (np.eye(model.states) - K @ model.H) @ model.F
    noise_gain: Floats = np.diag(model.H @ solve_discrete_lyapunov(A, K @ K.T) @ model.H.T)
    return noise_gain


def measured_noise_gain(model: Model, count: int = 1_000_000, seed: int = 3) -> Floats:
    """Return the noise gain (m,), measured on `count` rows of random noise."""
    z = np.random.default_rng(seed).normal(size=(count, model.channels))
    settled = slice(count // 100, None)
    after = kalman_filter(model, z, sigma=False, innovations=False).signal[settled]
    measured: Floats = np.mean(after**2, axis=0) / np.mean(z[settled] ** 2, axis=0)
    return measured


def response(model: Model, frequency_hz: Floats) -> Complexes:
    """Return the frequency response (k, m, m) in steady state; [:, i, j] is from reading j to output i."""
    K = settled_gain(model)
    A = (np.eye(model.states) - K @ model.H) @ model.F
    delay = np.exp(-2j * np.pi * np.asarray(frequency_hz) * T)[:, np.newaxis, np.newaxis]
    return np.asarray(model.H @ np.linalg.solve(np.eye(model.states) - A * delay, K), dtype=np.complex128)


class FrequencyLimits(NamedTuple):
    """The frequencies at which the printed matrices reach the printed output signal-to-noise ratio of a channel."""

    noise_above_hz: float  # least frequency of noise that is reduced at least as much as printed; inf if none is
    signal_below_hz: float  # motion without noise below this frequency is followed at least as well as printed


def frequency_limits(
    model: Model, channel: int, input_snr_paper_db: float, output_snr_paper_db: float
) -> FrequencyLimits:
    """Return the frequencies at which noise and motion have the paper's ratios, with a model's steady-state gain.

    Motion along also appears in the speed, so that two sensors measure it.

    Parameters
    ----------
    model : Model
        The three-sensor model.
    channel : int
        1 for the acceleration along, 2 for that up.
    input_snr_paper_db, output_snr_paper_db : float
        Printed signal-to-noise ratios of that acceleration, 20 log10 of a ratio of powers.
    """
    f = np.geomspace(0.01, RATE_HZ / 2, 20_000)
    G = response(model, f)
    moved = G[:, channel, channel].copy()
    if channel == 1:
        moved += G[:, 1, 0] * T / (1 - np.exp(-2j * np.pi * f * T))  # speed is the cumulative sum of acceleration
    noise_gain = np.abs(G[:, channel, channel]) ** 2
    distortion = np.abs(1 - moved) ** 2
    quiet = noise_gain <= 10 ** ((input_snr_paper_db - output_snr_paper_db) / 20)
    close = distortion <= 10 ** (-output_snr_paper_db / 20)
    far = f[~close]
    return FrequencyLimits(float(f[quiet].min()) if quiet.any() else np.inf, float(far.min()) if len(far) else np.inf)
