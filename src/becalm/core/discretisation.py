"""From continuous time to steps, exactly: what a linear system driven by white noise does over any length."""

from __future__ import annotations

from math import factorial

import numpy as np
from scipy.linalg import expm

from becalm.core.arrays import Floats


def discretise(A: Floats, W: Floats, steps_s: Floats) -> tuple[Floats, Floats]:
    """Integrate dx/dt = A x + w exactly over steps of several lengths.

    Parameters
    ----------
    A : (n, n) float array
        In 1/s.
    W : (n, n) float array
        Two-sided density of the white noise w.
    steps_s : (u,) float array
        Step lengths, in seconds, 0 or more.

    Returns
    -------
    F : (u, n, n) float array
        expm(A T) for each step.
    Q : (u, n, n) float array
        The noise gathered over the step, int_0^T expm(A s) W expm(A s)' ds.
    """
    if not np.linalg.matrix_power(A, len(A)).any():
        return _integrate_polynomial(A, W, steps_s)
    return _integrate_van_loan(A, W, steps_s)


def _integrate_polynomial(A: Floats, W: Floats, steps_s: Floats) -> tuple[Floats, Floats]:
    """For A^n = 0 the exponential is a polynomial, and so is the integral."""
    n = len(A)
    terms = [np.linalg.matrix_power(A, k) / factorial(k) for k in range(n)]
    T = steps_s[:, np.newaxis, np.newaxis]
    F = sum((terms[k] * T**k for k in range(n)), np.zeros((len(steps_s), n, n)))
    Q = np.zeros_like(F)
    for j in range(n):
        for k in range(n):
            Q += terms[j] @ W @ terms[k].T * T ** (j + k + 1) / (j + k + 1)
    return F, Q


def _integrate_van_loan(A: Floats, W: Floats, steps_s: Floats) -> tuple[Floats, Floats]:
    """Van Loan, IEEE TAC-23 (1978) 395: both from one exponential of a matrix twice as large.

    It holds expm(-A T) as well, beyond any number where something fades; so a step is halved until it
    is short, and doubled again: F <- F F, Q <- F Q F' + Q.
    """
    n, scale = len(A), float(np.abs(W).max(initial=0.0)) or 1.0
    reach = np.linalg.norm(A, np.inf) * np.abs(steps_s)
    halvings = np.ceil(np.log2(np.maximum(reach, 1.0))).astype(int)
    block = np.block([[-A, W / scale], [np.zeros_like(A), A.T]])
    E = expm(block * (steps_s / 2.0**halvings)[:, np.newaxis, np.newaxis])
    F = np.swapaxes(E[:, n:, n:], 1, 2)
    Q = F @ E[:, :n, n:]
    for k in range(int(halvings.max(initial=0))):
        late = halvings > k
        Q[late] = F[late] @ Q[late] @ np.swapaxes(F[late], 1, 2) + Q[late]
        F[late] = F[late] @ F[late]
    return F, scale * (Q + np.swapaxes(Q, 1, 2)) / 2
