"""Model: a linear Gaussian state-space model with checked, read-only matrices F, G, Q, H, R, x0 and P0."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats, frozen, real
from becalm.errors import ModelError

_SEMIDEFINITE = 1e-10  # largest magnitude of a negative eigenvalue from rounding, over the largest entry


class Model:
    """A linear Gaussian state-space model, x' = F x + G w, z = H x + v.

    Parameters
    ----------
    F : (n, n) array_like
        State transition matrix of one step.
    H : (m, n) array_like
        Measurement matrix: m channels, n states.
    Q : (p, p) array_like
        Covariance of the process noise w, in unit^2; a *small* Q trusts the model and smooths
        more. Without `G`, p = n.
    R : (m, m) array_like
        Covariance of the measurement noise v, in unit^2; a *small* R trusts the readings and
        smooths less. Zero is allowed if x0 and P0 are given.
    G : (n, p) array_like, optional
        Input matrix of the process noise; the identity by default.
    x0 : (n,) array_like, optional
        Expected state at the time of the first reading, before this reading is used.
    P0 : (n, n) array_like, optional
        Covariance of x0; may be singular. Give both x0 and P0, or neither. With neither, the filter
        starts from the first readings alone (a flat prior), with a correct variance.
    known : (n, n) array_like, optional
        Prior information, instead of x0 and P0: the inverse covariance of the states that have a prior with mean 0,
        such as stationary noise, and 0 for all other states.

    Raises
    ------
    ModelError
        If a shape does not fit, a number is not finite, a covariance is not symmetric and semidefinite, or x0, P0 and
        `known` contradict each other.
    """

    def __init__(  # noqa: PLR0913  (the letters of one textbook equation)
        self,
        F: ArrayLike,
        H: ArrayLike,
        Q: ArrayLike,
        R: ArrayLike,
        G: ArrayLike | None = None,
        x0: ArrayLike | None = None,
        P0: ArrayLike | None = None,
        known: ArrayLike | None = None,
    ) -> None:
        self.F: Floats = _matrix("F", F)
        n = len(self.F)
        _require_shape("F", self.F, (n, n), "a square matrix, one row per state")
        self.H: Floats = _matrix("H", H)
        m = len(self.H)
        _require_shape("H", self.H, (m, n), f"one row per channel and {n} columns, one per state")
        self.G: Floats = frozen(np.eye(n)) if G is None else _matrix("G", G)
        p = self.G.shape[1]
        _require_shape("G", self.G, (n, p), f"{n} rows, one per state")
        self.Q: Floats = checked_covariance("Q", Q, p)
        self.R: Floats = checked_covariance("R", R, m)
        if (x0 is None) != (P0 is None):
            raise ModelError("x0 and P0 belong together; give both, or neither to start from the first readings.")
        self.x0: Floats | None = None if x0 is None else _vector("x0", x0, n)
        self.P0: Floats | None = None if P0 is None else checked_covariance("P0", P0, n)
        self.known: Floats | None = None if known is None else checked_covariance("known", known, n)
        if x0 is not None and known is not None:
            raise ModelError("x0 and P0 already describe the whole prior; leave out either these two or known.")
        with np.errstate(over="ignore", invalid="ignore"):
            self.process_covariance: Floats = frozen(self.G @ self.Q @ self.G.T)
        if not np.isfinite(self.process_covariance).all():
            raise ModelError("G Q G' leaves the range of float64; choose smaller units for G or Q.")

    @property
    def states(self) -> int:
        """Return the number of states, n."""
        return len(self.F)

    @property
    def channels(self) -> int:
        """Return the number of channels, m."""
        return len(self.H)

    @cached_property
    def unobservable(self) -> Floats:
        """Return an orthonormal basis of the unobservable directions, (n, u); u is often 0."""
        rows, power, noise = [], np.eye(self.states), np.sqrt(np.diag(self.R))
        H = self.H / np.where(noise > 0, noise, 1.0)[:, np.newaxis]  # makes the rank independent of the channels' units
        for _ in range(self.states):
            block = H @ power
            scale = np.abs(block).max()
            rows.append(block / scale if scale > 0 else block)
            power = power @ self.F
            power = power / max(np.abs(power).max(), np.finfo(float).tiny)
        _, singular, vectors = np.linalg.svd(np.vstack(rows))
        rank = int((singular > 1e-12 * singular[0]).sum()) if singular[0] > 0 else 0
        return frozen(vectors[rank:].T)

    @property
    def observable_states(self) -> tuple[bool, ...]:
        """Return for each state whether the readings determine it."""
        return tuple(bool(abs(row).max(initial=0.0) < 1e-9) for row in self.unobservable)

    def __repr__(self) -> str:
        """Return a text with the numbers of states and channels."""
        return f"Model({self.states} states, {self.channels} channels)"


def checked_covariance(name: str, values: ArrayLike, size: int) -> Floats:
    """Return a frozen symmetric (size, size) covariance.

    Raises
    ------
    ModelError
        If the shape is wrong, a number is not finite, or the matrix is not symmetric and semidefinite.
    """
    own = np.array(_matrix(name, values))
    hint = f"For equal, independent noise pass {name} = variance * np.eye({size})."
    if own.shape != (size, size):
        raise ModelError(f"{name} has shape {own.shape}; ({size}, {size}) is needed. {hint}")
    largest = np.abs(own).max(initial=0.0)
    if np.abs(own - own.T).max(initial=0.0) > 1e-9 * largest:
        raise ModelError(f"{name} is not symmetric, so it is not a covariance. Pass ({name} + {name}.T) / 2.")
    own = (own + own.T) / 2
    lowest = float(np.linalg.eigvalsh(own)[0]) if size else 0.0
    if lowest < -_SEMIDEFINITE * largest:
        raise ModelError(f"{name} is not a covariance: its smallest eigenvalue is {lowest:.3g} < 0. {hint}")
    return frozen(own)


def _matrix(name: str, values: ArrayLike) -> Floats:
    own = _numbers(name, values)
    if own.ndim == 0:
        own = frozen(own.reshape(1, 1))
    if own.ndim != 2:
        raise ModelError(f"{name} has shape {own.shape}; a matrix is needed. Write {name} = [[...], [...]].")
    return own


def _vector(name: str, values: ArrayLike, size: int) -> Floats:
    own = _numbers(name, values)
    if own.shape != (size,):
        raise ModelError(f"{name} has shape {own.shape}; {size} states need ({size},).")
    return own


def _numbers(name: str, values: ArrayLike) -> Floats:
    try:
        own = frozen(real(values))
    except (TypeError, ValueError, OverflowError) as cause:
        raise ModelError(f"{name} is not an array of real numbers ({cause}).") from cause
    if not np.isfinite(own).all():
        raise ModelError(f"{name} holds a number that is not finite: {own.tolist()}.")
    return own


def _require_shape(name: str, own: Floats, shape: tuple[int, int], wanted: str) -> None:
    if own.shape != shape or 0 in own.shape:
        raise ModelError(f"{name} has shape {own.shape}; it needs {wanted}.")


# The matrices that a filter needs: matrices of its steps, and matrices of its sensors.


class System(NamedTuple):
    """Matrices F and Q of steps of u different lengths, and H and R of the sensors."""

    F: Floats  # (u, n, n)
    Q: Floats  # (u, n, n)
    H: Floats  # (m, n)
    R: Floats  # (m, m)
