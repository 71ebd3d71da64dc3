"""The reference Kalman filter and smoother: predict, update and smooth in plain NumPy with numbered equations.

This module is never optimised; the kernels must agree with it to 1e-12. Sources: Kalman 1960 for the filter; Bucy and
Joseph 1968 for Joseph's form; Bryson and Frazier 1963, in the form of Bierman 1973, for the smoother. This form needs
no inverse of a covariance, so that a singular P0, Q = 0 and R = 0 are allowed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats


class StateEstimate(NamedTuple):
    """Mean and covariance of the state at one time."""

    mean: Floats  # x, (n,)
    cov: Floats  # P, (n, n)


class ReferenceStep(NamedTuple):
    """The prior, the posterior and the innovation of one reading."""

    predicted: StateEstimate
    filtered: StateEstimate
    innovation: Floats  # nu, (m,), NaN where a channel is missing
    innovation_cov: Floats  # S of the channels that are not missing
    log_likelihood: float


def predict(state: StateEstimate, F: Floats, Q: Floats) -> StateEstimate:
    """Predict the state by one step."""
    x, P = state
    return StateEstimate(F @ x, F @ P @ F.T + Q)  # (1), (2)


def update(state: StateEstimate, H: Floats, R: Floats, reading: Floats) -> ReferenceStep:
    """Update the state with the channels of a reading that are not NaN."""
    x, P = state
    arrived = np.isfinite(reading)
    H, R = H[arrived], R[np.ix_(arrived, arrived)]
    nu = reading[arrived] - H @ x  # (3) innovation
    S = H @ P @ H.T + R  # (4) innovation covariance
    S_inverse = np.linalg.pinv(S, rcond=1e-15, hermitian=True).astype(np.float64)
    K = P @ H.T @ S_inverse  # (5) gain
    A = np.eye(len(x)) - K @ H
    filtered = StateEstimate(x + K @ nu, A @ P @ A.T + K @ R @ K.T)  # (6), (7) Joseph
    innovation = np.full(len(reading), np.nan)
    innovation[arrived] = nu
    return ReferenceStep(state, filtered, innovation, S, _log_density(nu, S, S_inverse))


def _log_density(nu: Floats, S: Floats, S_inverse: Floats) -> float:
    """Return the log of the normal density; directions without variance are left out (8)."""
    eigenvalues = np.linalg.eigvalsh(S)
    live = eigenvalues[eigenvalues > 1e-15 * eigenvalues.max(initial=0.0)]
    return float(-0.5 * (np.log(2 * np.pi * live).sum() + nu @ S_inverse @ nu))


def filter_readings(
    state: StateEstimate, F: Floats, Q: Floats, sensor: tuple[Floats, Floats], z: Floats
) -> list[ReferenceStep]:
    """Filter z (N, m); `state` is the prior at the first reading."""
    H, R = sensor
    steps = []
    for k, reading in enumerate(z):
        state = predict(state, F, Q) if k else state
        steps.append(update(state, H, R, reading))
        state = steps[-1].filtered
    return steps


def smooth(steps: list[ReferenceStep], F: Floats, H: Floats) -> list[StateEstimate]:
    """Smooth a filtered record: return the state at each row given all readings."""
    n = len(F)
    r, N = np.zeros(n), np.zeros((n, n))  # adjoint state of the later readings, and its covariance
    smoothed = []
    for step in reversed(steps):
        x, P = step.filtered
        smoothed.append(StateEstimate(x + P @ r, P - P @ N @ P))  # (9), (10)
        arrived = np.isfinite(step.innovation)
        H_k = H[arrived]
        S_inverse = np.linalg.pinv(step.innovation_cov, rcond=1e-15, hermitian=True)
        K = step.predicted.cov @ H_k.T @ S_inverse
        A = np.eye(n) - K @ H_k
        r = F.T @ (H_k.T @ S_inverse @ step.innovation[arrived] + A.T @ r)  # (11)
        N = F.T @ (H_k.T @ S_inverse @ H_k + A.T @ N @ A) @ F  # (12)
    return smoothed[::-1]


class Prediction(NamedTuple):
    """The result of one step of the one-step-prediction form."""

    state: Floats  # x(n+1 | n)
    cov: Floats  # P(n+1, n)
    filtered_cov: Floats
    gain: Floats  # K_G, which includes F


def predict_one_step(
    state: StateEstimate, F: Floats, Q: Floats, sensor: tuple[Floats, Floats], reading: Floats
) -> Prediction:
    """Take one step of the car paper's Appendix B; complex (Hermitian) signals are allowed.

    The returned state is the prediction x(n+1 | n) = F x(n | n), where x(n | n) is the result of `update`.
    """
    H, R = sensor
    x, P = state
    S = H @ P @ H.conj().T + R
    K_G = F @ P @ H.conj().T @ np.linalg.inv(S)  # (13)
    ahead = F @ x + K_G @ (reading - H @ x)  # (14)
    filtered = P - np.linalg.solve(F, K_G @ H @ P)  # (15)
    return Prediction(ahead, F @ filtered @ F.conj().T + Q, filtered, K_G)  # (16)
