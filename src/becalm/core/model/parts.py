"""What a model is made of, in continuous time: parts, each with its states named; `+` joins them.

A component is dx/dt = A x + B w, y = C x, whose noise w is white with spectral density W (two-sided:
unit^2 s, times 1/s^2 for each derivative that it drives). It becomes a `Model` for a step length in `to_model`.
A part may instead be a recursion over even steps, which has no continuous time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Literal

import numpy as np

from becalm.core.arrays import Floats, block_diagonal, frozen
from becalm.core.model.discretisation import Recursion, balancing, discretise, repeat
from becalm.core.model.model import Model
from becalm.errors import ModelError


@dataclass(frozen=True)
class Part:
    """What some states of a component stand for.

    Attributes
    ----------
    name : str
        Of the part, such as "motion" or "oscillator at 3 Hz".
    state_names : tuple of str
        What each of its states is.
    disturbance : bool
        Whether it is read but no part of the signal.
    recursion : Recursion or None
        Its even step, of a part that has no continuous time; its blocks of drift and density are zero.
    """

    name: str
    state_names: tuple[str, ...]
    disturbance: bool = False
    recursion: Recursion | None = None


@dataclass(frozen=True, eq=False)
class Component:
    """One part of what is read, or several joined, in continuous time.

    Attributes
    ----------
    drift : (n, n) float array
        A in dx/dt = A x + B w, in 1/s.
    noise_input : (n, p) float array
        B: how the white noise w enters.
    noise_density : (p, p) float array
        W: two-sided spectral density of w, in unit^2/s^(2d - 1) where it drives the d-th derivative;
        a *small* one trusts the model and smooths more.
    output : (1, n) float array
        C in y = C x.
    parts : tuple of Part
        What the states are, in their order.

    Raises
    ------
    ModelError
        If a number is not finite.
    """

    drift: Floats
    noise_input: Floats
    noise_density: Floats
    output: Floats
    parts: tuple[Part, ...]

    def __post_init__(self) -> None:
        """Refuse what float64 cannot hold."""
        if not all(np.isfinite(own).all() for own in (self.drift, self.noise_density)):
            names = ", ".join(part.name for part in self.parts)
            raise ModelError(f"The numbers of {names} leave the range of float64; choose a unit nearer to their size.")

    @property
    def state_names(self) -> tuple[str, ...]:
        """What each state is."""
        return tuple(name for part in self.parts for name in part.state_names)

    @property
    def signal_output(self) -> Floats:
        """The output without the disturbances, (1, n)."""
        return sum((output for part, output in self.outputs() if not part.disturbance), np.zeros_like(self.output))

    @cached_property
    def level_direction(self) -> Floats | None:
        """What is added to the states (n,) when a constant is added to y, and stays; None where none does."""
        states, n = self._slices()[0], len(self.drift)
        for last in dict.fromkeys((0, states.stop - 1)):  # a motion's level, or it with the level that it returns to
            direction = np.zeros(n)
            direction[[0, last]] = 1.0
            stays = self.parts[0].recursion is None and not (self.drift @ direction).any()
            if stays and (self.output @ direction == 1.0).all():
                return frozen(direction)
        return None

    @property
    def keeps_level(self) -> bool:
        """Whether a constant may be added to y for good, so that readings may be told from any level."""
        return self.level_direction is not None

    @property
    def returns(self) -> bool:
        """Whether the first part, a motion, is damped towards a level of its own, its last state."""
        last = self._slices()[0].stop - 1
        return bool(last > 0 and self.drift[last, last] < 0.0 and self.keeps_level)

    @property
    def goes_in_steps(self) -> bool:
        """Whether a part is known at whole steps only."""
        return any(part.recursion is not None for part in self.parts)

    @cached_property
    def known(self) -> Floats | None:
        """What is known of the states before any reading, as an inverse covariance (n, n); None where nothing is.

        Of a recursion, that it is stationary, for it could not be told from a motion by its first readings; and so of
        the distance of a motion from the level that it returns to.
        """
        if not (self.goes_in_steps or self.returns):
            return None
        Y = np.zeros_like(self.drift)
        for part, states in zip(self.parts, self._slices(), strict=True):
            if part.recursion is not None:
                from scipy.linalg import solve_discrete_lyapunov

                Y[states, states] = np.linalg.inv(solve_discrete_lyapunov(part.recursion.F, part.recursion.Q))
        if self.returns:
            states = self._slices()[0]
            W = self.noise_input @ self.noise_density @ self.noise_input.T
            Y[states, states] = _about_level(self.drift[states, states], W[states, states])
        return (Y + Y.T) / 2

    def outputs(self) -> list[tuple[Part, Floats]]:
        """Split the output: return each part with the row (1, n) that gives its share of y."""
        rows = []
        for part, states in zip(self.parts, self._slices(), strict=True):
            own = np.zeros_like(self.output)
            own[:, states] = self.output[:, states]
            rows.append((part, own))
        return rows

    def _refuse_recursions(self) -> None:
        names = [part.name for part in self.parts if part.recursion is not None]
        if names:
            raise ModelError(
                f"There is no Euler form of {names[0]}, which goes in even steps; use discretisation = 'exact'."
            )

    def _slices(self) -> list[slice]:
        bounds = np.cumsum([0, *(len(part.state_names) for part in self.parts)])
        return [slice(first, stop) for first, stop in pairwise(bounds.tolist())]

    def as_disturbance(self) -> Component:
        """Return the component as one that is read, but is no part of the signal."""
        return replace(self, parts=tuple(replace(part, disturbance=True) for part in self.parts))

    def __add__(self, other: Component) -> Component:
        """Join two independent components; their outputs add."""
        return Component(
            frozen(block_diagonal(self.drift, other.drift)),
            frozen(block_diagonal(self.noise_input, other.noise_input)),
            frozen(block_diagonal(self.noise_density, other.noise_density)),
            frozen(np.hstack([self.output, other.output])),
            self.parts + other.parts,
        )

    def over(self, steps_s: Floats) -> tuple[Floats, Floats]:
        """Integrate exactly over steps of several lengths (u,), in seconds; return F and Q, (u, n, n) each.

        Part by part, so that each keeps its own digits, however small its noise is beside another's.

        Raises
        ------
        ModelError
            If a part goes in even steps, and a length is no whole number of them.
        """
        W = self.noise_input @ self.noise_density @ self.noise_input.T
        F, Q = np.zeros((2, len(steps_s), *W.shape))
        for part, states in zip(self.parts, self._slices(), strict=True):
            own = np.index_exp[:, states, states]
            if part.recursion is not None:
                F[own], Q[own] = repeat(part.recursion, steps_s)
            else:
                F[own], Q[own] = discretise(self.drift[states, states], W[states, states], steps_s)
        return F, Q

    @lru_cache(maxsize=256)  # noqa: B019  (a few hundred small matrices; a filter, its gate and its gap limit ask alike)
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
            "exact" integrates the noise over the step, by series (`discretisation`); "euler" is the first-order
            form F = I + T A, G = T B with the density taken as the covariance of each step's
            noise, as in the IMU paper.

        Raises
        ------
        ModelError
            If the step is not positive or the variance is negative; if a part goes in even steps, and
            this is no whole number of them, or the Euler form is asked for.
        """
        step_s = checked_step(step_s)
        R = [[noise_variance]]
        if discretisation == "euler":
            self._refuse_recursions()
            F, G = np.eye(len(self.drift)) + step_s * self.drift, step_s * self.noise_input
            return Model(F=F, H=self.output, Q=self.noise_density, R=R, G=G)
        if discretisation != "exact":
            raise ModelError(f"discretisation = {discretisation!r} is not known; use 'exact' or 'euler'.")
        F, Q = self.over(np.array([step_s]))
        return Model(F=F[0], H=self.output, Q=Q[0], R=R, known=self.known)


def _about_level(A: Floats, W: Floats) -> Floats:
    """Return what is known, (n + 1, n + 1), of a motion that is stationary about its last state, an unknown level."""
    from scipy.linalg import solve_continuous_lyapunov

    n = len(A) - 1
    apart, together = np.eye(n + 1), np.eye(n + 1)
    apart[0, n], together[0, n] = -1.0, 1.0  # to the distance from the level, and back
    own = (apart @ A @ together)[:n, :n]
    scale = balancing(own)
    P = solve_continuous_lyapunov(own / scale[:, np.newaxis] * scale, -W[:n, :n] / np.outer(scale, scale))
    Y = np.zeros((n + 1, n + 1))
    if np.isfinite(P).all() and (P.diagonal() > 0.0).all():
        Y[:n, :n] = np.linalg.inv(P) / np.outer(scale, scale)
    return np.asarray(apart.T @ Y @ apart)


def checked_number(name: str, value: object, what: str, needed: str, *, zero: bool = False) -> float:
    """Return a finite number above zero, or of zero as well, as float.

    Parameters
    ----------
    name : str
        What a person calls it.
    value : object
        What a person gave.
    what, needed : str
        What it should be, and what to give; "or 0" is added where zero is allowed.
    zero : bool
        Whether it may be zero.

    Raises
    ------
    ModelError
        If it is not a number (truth values and text are none), not finite, or negative.
    """
    given = np.asarray(value if np.isscalar(value) or isinstance(value, np.ndarray) else None)
    number = float(given) if given.ndim == 0 and given.dtype.kind in "iuf" else np.nan
    if not (0 < number < np.inf or (zero and number == 0)):
        raise ModelError(f"{name} = {value!r} is not {what}; give {needed}{' or 0' if zero else ''}.")
    return number


def checked_step(step_s: object) -> float:
    """Return a step in seconds as float.

    Raises
    ------
    ModelError
        If it is not a number, not finite, or not above zero.
    """
    return checked_number("step_s", step_s, "a step", "a positive number of seconds")


def checked_whole(name: str, value: object, refusal: str, highest: float = np.inf) -> int:
    """Return a whole number from 1 to `highest`; `refusal` ends the sentence that refuses another.

    Raises
    ------
    ModelError
        If it is not whole, or beyond.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 1 <= value <= highest:
        raise ModelError(f"{name} = {value!r} {refusal}")
    return int(value)
