"""The catalogue of signals: level, n-th order motion; `+` joins them; Euler or exact steps.

A component is a continuous-time model dx/dt = A x + B w, y = C x, whose noise w is white with
spectral density W (two-sided, unit^2 s). It becomes a `Model` for a step length in `to_model`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial
from typing import Literal

import numpy as np
from scipy.linalg import block_diag, expm

from becalm.core.arrays import Floats, frozen
from becalm.core.model import Model
from becalm.errors import ModelError

HIGHEST_ORDER = 5

ORDERS = (1, 2, 3)
"""Orders of motion that are chosen between."""


@dataclass(frozen=True, eq=False)
class Component:
    """One part of a signal, in continuous time.

    Attributes
    ----------
    drift : (n, n) float array
        A in dx/dt = A x + B w, in 1/s.
    noise_input : (n, p) float array
        B: how the white noise w enters.
    noise_density : (p, p) float array
        W: spectral density of w; a *small* one trusts the model and smooths more.
    output : (1, n) float array
        C in y = C x.
    state_names : tuple of n str
        What each state is.
    """

    drift: Floats
    noise_input: Floats
    noise_density: Floats
    output: Floats
    state_names: tuple[str, ...]

    def __add__(self, other: Component) -> Component:
        """Join two independent components; their outputs add."""
        return Component(
            frozen(block_diag(self.drift, other.drift)),
            frozen(block_diag(self.noise_input, other.noise_input)),
            frozen(block_diag(self.noise_density, other.noise_density)),
            frozen(np.hstack([self.output, other.output])),
            self.state_names + other.state_names,
        )

    def to_model(
        self, step_s: float, noise_variance: float, discretisation: Literal["exact", "euler"] = "exact"
    ) -> Model:
        """Make the Model of one channel that reads y every `step_s` seconds.

        Parameters
        ----------
        step_s : float
            Step in seconds.
        noise_variance : float
            R, the variance of one reading's noise, in unit^2.
        discretisation : {"exact", "euler"}
            "exact" integrates the noise over the step (Van Loan 1978); "euler" is the first-order
            form F = I + T A, G = T B with the density taken as the covariance of each step's
            noise, as in the IMU paper.

        Raises
        ------
        ModelError
            If the step is not positive or the variance is negative.
        """
        if not (0 < step_s < np.inf):
            raise ModelError(f"step_s = {step_s} is not a step; give a positive number of seconds.")
        R = [[noise_variance]]
        if discretisation == "euler":
            F, G = np.eye(len(self.drift)) + step_s * self.drift, step_s * self.noise_input
            return Model(F=F, H=self.output, Q=self.noise_density, R=R, G=G)
        if discretisation != "exact":
            raise ModelError(f"discretisation = {discretisation!r} is not known; use 'exact' or 'euler'.")
        F, Q = discretise(self, np.array([step_s]))
        return Model(F=F[0], H=self.output, Q=Q[0], R=R)


def level(noise_density: float = 1.0) -> Component:
    """Return a level that wanders: a random walk with `noise_density` in unit^2/s."""
    return motion(1, noise_density)


def motion(order: int, noise_density: float = 1.0) -> Component:
    """Return n-th order motion: white noise on the n-th derivative of the signal.

    Parameters
    ----------
    order : int
        1 is a random walk, 2 a walking slope (constant velocity), 3 constant acceleration; to 5.
    noise_density : float
        Two-sided density of the noise on the n-th derivative, in unit^2/s^(2n-1); a *small* one
        trusts the polynomial and smooths more.

    Raises
    ------
    ModelError
        If the order is not 1 to 5 or the density is negative or not finite.

    Notes
    -----
    The steady filter is a Butterworth low-pass with slopes kept, of cut-off
    (density / (R T))^(1/2n) rad/s. Not to be confused with the piecewise-constant noise of
    Kalata's alpha-beta filter (IEEE TAES-20, 1984), whose process covariance has rank one.
    """
    if order not in range(1, HIGHEST_ORDER + 1):
        raise ModelError(f"order = {order} is not offered; choose 1 (level) to {HIGHEST_ORDER}.")
    if not (0 <= noise_density < np.inf):
        raise ModelError(f"noise_density = {noise_density} is not a density; give 0 or a positive number.")
    drift = np.eye(order, k=1)
    enters, sees = np.zeros((order, 1)), np.zeros((1, order))
    enters[-1, 0] = sees[0, 0] = 1.0
    names = ("level", "velocity", "acceleration", "jerk", "snap")[:order]
    return Component(frozen(drift), frozen(enters), frozen([[noise_density]]), frozen(sees), names)


def discretise(component: Component, steps_s: Floats) -> tuple[Floats, Floats]:
    """Integrate a component exactly over steps of several lengths.

    Parameters
    ----------
    component : Component
        The continuous-time model.
    steps_s : (u,) float array
        Step lengths, in seconds, 0 or more.

    Returns
    -------
    F : (u, n, n) float array
        expm(A T) for each step.
    Q : (u, n, n) float array
        The noise gathered over the step, int_0^T expm(A s) B W B' expm(A s)' ds.
    """
    A, W = component.drift, component.noise_input @ component.noise_density @ component.noise_input.T
    n = len(A)
    if not np.linalg.matrix_power(A, n).any():
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
    """Van Loan, IEEE TAC-23 (1978) 395: both from one exponential of a matrix twice as large."""
    n = len(A)
    block = np.block([[-A, W], [np.zeros_like(A), A.T]])
    E = expm(block * steps_s[:, np.newaxis, np.newaxis])
    F = np.swapaxes(E[:, n:, n:], 1, 2)
    Q = F @ E[:, :n, n:]
    return F, (Q + np.swapaxes(Q, 1, 2)) / 2
