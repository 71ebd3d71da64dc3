"""Coloured noise: the noise of a measurement is correlated with that of the measurements before it.

Autoregressive noise of order p is e[k] = phi_1 e[k-1] + ... + phi_p e[k-p] + w[k], with white noise w. It is defined
only at the measurements, so its steps are even; a missing reading also counts as a step. The noise is stationary if and
only if all its partial autocorrelations are below 1 in size; Levinson's recursion computes them in reverse order.
Sources: Levinson, J. Math. Phys. 25 (1947) 261; Durbin, Rev. Int. Stat. Inst. 28 (1960) 233; Barndorff-Nielsen and
Schou, J. Multivariate Analysis 3 (1973) 408.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import frozen, real
from becalm.core.model.discretisation import Recursion
from becalm.core.model.parts import Component, Part, checked_number, checked_step
from becalm.errors import ModelError


class ColouredNoise(NamedTuple):
    """Autoregressive noise with one step per reading.

    Attributes
    ----------
    coefficients : tuple of float
        phi_1 to phi_p of e[k] = sum phi_i e[k-i] + w[k]; *small* ones mean a short correlation time, so that
        longer deviations count as signal.
    variance : float
        Variance of e, in unit^2; a *small* one attributes more of the readings to the other components.
    """

    coefficients: tuple[float, ...]
    variance: float

    @property
    def innovation_variance(self) -> float:
        """Return the variance of w, in unit^2: the part of the noise that its earlier values do not predict."""
        return self.variance * _unexplained(partial_autocorrelations(self.coefficients))


def autoregressive(coefficients: Sequence[float], std: float = 1.0, step_s: float = 1.0) -> Component:
    """Return autoregressive noise as a component; it is a disturbance, and is defined only over whole steps.

    Parameters
    ----------
    coefficients : sequence of float
        phi_1 to phi_p of e[k] = sum phi_i e[k-i] + w[k]; zeros at the end are ignored.
    std : float
        Standard deviation of e, in unit; a *small* one attributes more of the readings to the other components.
    step_s : float
        Time from e[k-1] to e[k], in seconds.

    Raises
    ------
    ModelError
        If all coefficients are zero, the noise is not stationary, a number is not finite, or `std` or `step_s` is not
        positive.

    Notes
    -----
    The states are e[k] to e[k-p+1]. Order 1 with phi > 0 is Gauss-Markov noise with phi = exp(-T / correlation_s).
    """
    phi = _checked_coefficients(coefficients)
    std = checked_number("std", std, "a standard deviation", "a positive number")
    step_s = checked_step(step_s)
    partial = partial_autocorrelations(phi)
    if not all(abs(kappa) < 1 for kappa in partial):
        raise ModelError(
            f"coefficients = {phi} are not stationary: their noise grows without bound. Give coefficients whose poles, "
            "the roots of z^p - phi_1 z^(p-1) - ... - phi_p, lie inside the unit circle; for a drift use bias."
        )
    p = len(phi)
    F, Q, zeros = np.eye(p, k=-1), np.zeros((p, p)), frozen(np.zeros((p, p)))
    F[0], Q[0, 0] = phi, std * std * _unexplained(partial)
    if not np.isfinite(Q[0, 0]):
        raise ModelError(f"std = {std} leaves the range of float64 when squared; choose a larger unit.")
    names = ("noise", "noise 1 step before", *(f"noise {k} steps before" for k in range(2, p)))[:p]
    part = Part("coloured noise", names, disturbance=True, recursion=Recursion(frozen(F), frozen(Q), step_s))
    return Component(zeros, frozen(np.eye(p)), zeros, frozen(np.eye(1, p)), (part,))


def partial_autocorrelations(coefficients: Sequence[float]) -> tuple[float, ...]:
    """Return kappa_1 to kappa_p of coefficients phi_1 to phi_p.

    Notes
    -----
    If a kappa reaches 1 in size, the noise is not stationary, and the kappas of lower order cannot be
    computed: they are NaN.
    """
    phi, partial = np.array(coefficients, dtype=np.float64), []
    while len(phi):
        kappa = float(phi[-1])
        partial.append(kappa)
        if not abs(kappa) < 1:
            return (*[np.nan] * (len(phi) - 1), *reversed(partial))
        phi = (phi[:-1] + kappa * phi[-2::-1]) / ((1 - kappa) * (1 + kappa))
    return tuple(reversed(partial))


def from_partial_autocorrelations(partial: Sequence[float]) -> tuple[float, ...]:
    """Return the coefficients phi_1 to phi_p of partial autocorrelations, each between -1 and 1."""
    phi = np.zeros(0)
    for kappa in partial:
        phi = np.append(phi - kappa * phi[::-1], kappa)
    return tuple(phi.tolist())


def _unexplained(partial: Sequence[float]) -> float:
    """Return the share of the variance that earlier noise does not predict."""
    return float(np.prod([(1 - kappa) * (1 + kappa) for kappa in partial]))


def _checked_coefficients(given: ArrayLike) -> tuple[float, ...]:
    try:
        phi = frozen(real(given))
    except (TypeError, ValueError) as cause:
        raise ModelError(f"coefficients = {given!r} are not numbers; give phi_1 to phi_p: (0.9,).") from cause
    if phi.ndim != 1 or not np.isfinite(phi).all():
        raise ModelError(f"coefficients = {given!r} are not a row of finite numbers; give phi_1 to phi_p: (0.9,).")
    if not phi.any():
        raise ModelError(
            f"coefficients = {given!r} have no value but 0: that is white noise, whose variance belongs in R "
            "(noise_variance). Give at least one that is not 0."
        )
    return tuple(phi[: np.flatnonzero(phi)[-1] + 1].tolist())
