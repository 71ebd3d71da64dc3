"""Coloured noise: the noise of a measurement is correlated with that of the measurements before it.

Autoregressive noise of order p is e[k] = phi_1 e[k-1] + ... + phi_p e[k-p] + w[k], w white. It is known
where the sensor reads and nowhere between, so it goes in even steps; readings that are missing are
steps all the same. Its partial autocorrelations, all of them below 1 in size if and only if the noise
is stationary, are found by Levinson's recursion run backwards. Sources: Levinson, J. Math. Phys. 25
(1947) 261; Durbin, Rev. Int. Stat. Inst. 28 (1960) 233; Barndorff-Nielsen and Schou, J. Multivariate
Analysis 3 (1973) 408.
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
    """Autoregressive noise that goes one step a reading.

    Attributes
    ----------
    coefficients : tuple of float
        phi_1 to phi_p of e[k] = sum phi_i e[k-i] + w[k]; *small* ones trust noise to forget soon,
        so that what lasts is taken for signal.
    variance : float
        Of e, in unit^2; a *small* one leaves more to the other components.
    """

    coefficients: tuple[float, ...]
    variance: float

    @property
    def innovation_variance(self) -> float:
        """Variance of w, in unit^2: what of a reading's noise those before it do not tell."""
        return self.variance * _unexplained(partial_autocorrelations(self.coefficients))


def autoregressive(coefficients: Sequence[float], std: float = 1.0, step_s: float = 1.0) -> Component:
    """Return autoregressive noise, a disturbance: exact over whole numbers of steps, and refused over others.

    Parameters
    ----------
    coefficients : sequence of float
        phi_1 to phi_p of e[k] = sum phi_i e[k-i] + w[k]; zeros at the end are left out.
    std : float
        Standard deviation of e, in unit; a *small* one leaves more to the other components.
    step_s : float
        Time from e[k-1] to e[k], in seconds.

    Raises
    ------
    ModelError
        If there is no coefficient but zeros, the noise they describe is not stationary, or a number is
        not finite, negative, or no step.

    Notes
    -----
    The states are e[k] to e[k-p+1]. Of order 1 it is Gauss-Markov noise with phi = exp(-T / correlation_s).
    """
    phi = _coefficients(coefficients)
    std = checked_number("std", std, "a standard deviation", "a positive number", zero=True)
    step_s = checked_step(step_s)
    partial = partial_autocorrelations(phi)
    if not all(abs(kappa) < 1 for kappa in partial):
        raise ModelError(
            f"coefficients = {phi} do not fade: noise that they describe grows for ever. Give some whose poles, the "
            "roots of z^p - phi_1 z^(p-1) - ... - phi_p, lie within the unit circle; for what wanders use bias."
        )
    p = len(phi)
    F, Q, nothing = np.eye(p, k=-1), np.zeros((p, p)), frozen(np.zeros((p, p)))
    F[0], Q[0, 0] = phi, std * std * _unexplained(partial)
    if not np.isfinite(Q[0, 0]):
        raise ModelError(f"std = {std} leaves the range of float64 when it is squared; choose a larger unit.")
    names = ("noise", "noise 1 step before", *(f"noise {k} steps before" for k in range(2, p)))[:p]
    part = Part("coloured noise", names, disturbance=True, recursion=Recursion(frozen(F), frozen(Q), step_s))
    return Component(nothing, frozen(np.eye(p)), nothing, frozen(np.eye(1, p)), (part,))


def partial_autocorrelations(coefficients: Sequence[float]) -> tuple[float, ...]:
    """Return kappa_1 to kappa_p of coefficients phi_1 to phi_p.

    Notes
    -----
    Where a kappa reaches 1 in size the noise is not stationary, and those of lower order are not
    found: NaN stands for them.
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
    """Return the share of the variance that the noise before does not tell."""
    return float(np.prod([(1 - kappa) * (1 + kappa) for kappa in partial]))


def _coefficients(given: ArrayLike) -> tuple[float, ...]:
    try:
        phi = frozen(real(given))
    except (TypeError, ValueError) as cause:
        raise ModelError(f"coefficients = {given!r} are not numbers; give phi_1 to phi_p, as (0.9,).") from cause
    if phi.ndim != 1 or not np.isfinite(phi).all():
        raise ModelError(f"coefficients = {given!r} are no row of finite numbers; give phi_1 to phi_p, as (0.9,).")
    if not phi.any():
        raise ModelError(
            f"coefficients = {given!r} remember nothing: that is white noise, whose variance belongs into R "
            "(noise_variance). Give at least one that is not 0."
        )
    return tuple(phi[: np.flatnonzero(phi)[-1] + 1].tolist())
