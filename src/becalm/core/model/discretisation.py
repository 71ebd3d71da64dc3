"""Exact discretisation of linear systems that are driven by white noise, for steps of any length."""

from __future__ import annotations

from functools import lru_cache
from math import factorial, isqrt
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import ModelError

_TERMS = 24  # terms of a series whose argument is at most 1
_CACHED_SIZE = 1 << 13  # matrices with more numbers in total are not cached
_MOST_STEPS = 2.0**53  # above it float64 cannot hold every whole number
_WHOLE = 1e-9  # largest distance from a whole number of steps, over this number, or over 1 if the number is 0


class Recursion(NamedTuple):
    """One step of a process in discrete time: x[k] = F x[k-1] + w."""

    F: Floats  # (n, n)
    Q: Floats  # (n, n) covariance of w
    step_s: float  # length of the step, in seconds


def discretise(A: Floats, W: Floats, steps_s: Floats) -> tuple[Floats, Floats]:
    """Integrate dx/dt = A x + w exactly over steps of several lengths.

    Parameters
    ----------
    A : (n, n) float array
        System matrix, in 1/s.
    W : (n, n) float array
        Two-sided density of the white noise w.
    steps_s : (u,) float array
        Step lengths in seconds, 0 or more.

    Returns
    -------
    F : (u, n, n) float array
        expm(A T) for each step.
    Q : (u, n, n) float array
        Covariance of the noise over the step, int_0^T expm(A s) W expm(A s)' ds.
    """
    if not np.linalg.matrix_power(A, len(A)).any():
        return _integrate_polynomial(A, W, steps_s)
    if _is_tone(A, W):
        return _integrate_tone(A, W, steps_s)
    if len(steps_s) * A.size > _CACHED_SIZE:
        return _integrate_series(A, W, steps_s)
    F, Q = _cached_series(A.tobytes(), W.tobytes(), steps_s.tobytes())
    return F.copy(), Q.copy()


@lru_cache(maxsize=256)
def _cached_series(A: bytes, W: bytes, steps_s: bytes) -> tuple[Floats, Floats]:
    """Integrate over a few lengths and cache the result: tuning needs the same matrices hundreds of times."""
    n = isqrt(len(A) // np.dtype(np.float64).itemsize)
    return _integrate_series(np.frombuffer(A).reshape(n, n), np.frombuffer(W).reshape(n, n), np.frombuffer(steps_s))


def repeat(one: Recursion, steps_s: Floats) -> tuple[Floats, Floats]:
    """Repeat one step exactly over steps of several lengths.

    Parameters
    ----------
    one : Recursion
        The step that is repeated.
    steps_s : (u,) float array
        Step lengths in seconds: whole multiples of `one.step_s`, including 0, up to rounding.

    Returns
    -------
    F : (u, n, n) float array
        F^k for each length of k steps.
    Q : (u, n, n) float array
        Covariance of the noise over the length, the sum of F^j Q F^j' for j < k; no digits cancel in this sum.

    Raises
    ------
    ModelError
        If a length is not a whole number of steps, 0 to 2^53.

    Notes
    -----
    F^k is computed by doubling along the binary digits of k: F <- F F and Q <- F Q F' + Q.
    """
    counts = np.round(steps_s / one.step_s)
    with np.errstate(invalid="ignore"):  # infinite lengths
        whole = np.abs(steps_s / one.step_s - counts) <= _WHOLE * np.maximum(counts, 1.0)
    invalid = ~(whole & (counts >= 0.0) & (counts <= _MOST_STEPS))
    if invalid.any():
        raise ModelError(
            f"Noise with a step of {one.step_s:.6g} s cannot be computed over {steps_s[invalid][0]:.6g} s, which is "
            "not a whole number of steps. Give readings in even time, or use gauss_markov, which allows any time."
        )
    remaining = counts.astype(np.int64)
    F = np.broadcast_to(np.eye(len(one.F)), (len(counts), *one.F.shape)).copy()
    Q = np.zeros((len(counts), *one.Q.shape))
    power, noise = one.F, one.Q
    while remaining.any():
        odd = remaining % 2 == 1
        F[odd], Q[odd] = power @ F[odd], power @ Q[odd] @ power.T + noise
        power, noise, remaining = power @ power, power @ noise @ power.T + noise, remaining // 2
    return F, (Q + np.swapaxes(Q, 1, 2)) / 2


def _integrate_polynomial(A: Floats, W: Floats, steps_s: Floats) -> tuple[Floats, Floats]:
    """Integrate for A^n = 0: the exponential and its integral are polynomials."""
    n = len(A)
    terms = [np.linalg.matrix_power(A, k) / factorial(k) for k in range(n)]
    T = steps_s[:, np.newaxis, np.newaxis]
    F = sum((terms[k] * T**k for k in range(n)), np.zeros((len(steps_s), n, n)))
    Q = np.zeros_like(F)
    for j in range(n):
        for k in range(n):
            Q += terms[j] @ W @ terms[k].T * T ** (j + k + 1) / (j + k + 1)
    return F, Q


def _is_tone(A: Floats, W: Floats) -> bool:
    """Return whether the system is one decaying state, or a rotating and decaying pair with isotropic noise."""
    if len(A) == 1:
        return True
    pair = len(A) == 2 and A[0, 0] == A[1, 1] and A[0, 1] == -A[1, 0]
    return bool(pair and W[0, 0] == W[1, 1] and W[0, 1] == W[1, 0] == 0.0)


def _integrate_tone(A: Floats, W: Floats, steps_s: Floats) -> tuple[Floats, Floats]:
    """Integrate in closed form: F = e^(a T) times a rotation, and Q = W (e^(2 a T) - 1) / (2 a)."""
    a, T = float(A[0, 0]), steps_s[:, np.newaxis, np.newaxis]
    F = np.exp(a * T) * np.eye(len(A))
    if len(A) == 2:
        angle = A[0, 1] * T
        F = np.exp(a * T) * (np.cos(angle) * np.eye(2) + np.sin(angle) * np.array([[0.0, 1.0], [-1.0, 0.0]]))
    return F, W * (T if a == 0.0 else np.expm1(2 * a * T) / (2 * a))


def balancing(A: Floats) -> Floats:
    """Return the scale (n,) of each state that balances A (n, n): its entries become similar in size."""
    from scipy.linalg import matrix_balance

    with np.errstate(invalid="ignore"):  # the permutation, which is not used, may give this warning
        _, (scale, _) = matrix_balance(A, permute=False, separate=True)
    return np.asarray(scale)


def _integrate_series(A: Floats, W: Floats, steps_s: Floats) -> tuple[Floats, Floats]:
    """Sum both series: F = sum of A^k T^k / k!, Q = sum of L^k(W) T^(k+1) / (k+1)!, with L(X) = A X + X A'.

    The states are balanced first, so that every entry keeps its digits, even for a chain of integrators with weak
    damping. The step is halved until the series converge; then the matrices are combined to those of the whole step
    by repeated doubling: F <- F F, Q <- F Q F' + Q.
    """
    scale = balancing(A)
    balanced, integrand = A / scale[:, np.newaxis] * scale, W / np.outer(scale, scale)
    reach = 2 * np.linalg.norm(balanced, np.inf) * steps_s
    halvings = np.ceil(np.log2(np.maximum(reach, 1.0))).astype(int)
    T = (steps_s / 2.0**halvings)[:, np.newaxis, np.newaxis]
    power, F, Q = np.eye(len(A)), np.zeros((len(steps_s), *A.shape)), np.zeros((len(steps_s), *A.shape))
    term = np.ones_like(T)
    for k in range(_TERMS):
        F += power * term
        term = term * T / (k + 1)
        Q += integrand * term
        power, integrand = power @ balanced, balanced @ integrand + integrand @ balanced.T
    for k in range(int(halvings.max(initial=0))):
        more = halvings > k
        Q[more] = F[more] @ Q[more] @ np.swapaxes(F[more], 1, 2) + Q[more]
        F[more] = F[more] @ F[more]
    Q *= np.outer(scale, scale)
    return F * scale[:, np.newaxis] / scale, (Q + np.swapaxes(Q, 1, 2)) / 2
