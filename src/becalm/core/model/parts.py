"""Components of a model in continuous time: each has parts with named states; `+` joins components.

A component is dx/dt = A x + B w, y = C x, with white noise w of two-sided spectral density W. If the noise drives the
d-th derivative of y, W is in unit^2/s^(2d - 1). `to_model` makes a `Model` for a step length. A part may also be a
recursion in discrete time, with even steps.
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
from becalm.core.reading_verdicts import BEYOND_ANY_SENSOR
from becalm.errors import ModelError


@dataclass(frozen=True)
class Part:
    """The meaning of some states of a component.

    Attributes
    ----------
    name : str
        Name of the part, such as "motion" or "oscillator at 3 Hz".
    state_names : tuple of str
        Names of the states of the part.
    disturbance : bool
        True if the part is in the readings but not in the signal.
    recursion : Recursion or None
        The step of a part in discrete time; the blocks of this part in drift and density are zero.
    """

    name: str
    state_names: tuple[str, ...]
    disturbance: bool = False
    recursion: Recursion | None = None


@dataclass(frozen=True, eq=False)
class Component:
    """A model of the readings, or of a part of them, in continuous time.

    Attributes
    ----------
    drift : (n, n) float array
        A in dx/dt = A x + B w, in 1/s.
    noise_input : (n, p) float array
        B: input matrix of the white noise w.
    noise_density : (p, p) float array
        W: two-sided spectral density of w, in unit^2/s^(2d - 1) if w drives the d-th derivative; a *small* one
        trusts the model and smooths more.
    output : (1, n) float array
        C in y = C x.
    parts : tuple of Part
        The meaning of the states, in their order.

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
        """Raise an error if a number overflowed float64."""
        if not all(np.isfinite(own).all() for own in (self.drift, self.noise_density)):
            names = ", ".join(part.name for part in self.parts)
            raise ModelError(f"The numbers of {names} leave the range of float64; choose a unit nearer to their size.")

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the name of each state."""
        return tuple(name for part in self.parts for name in part.state_names)

    @property
    def signal_output(self) -> Floats:
        """Return the output matrix without the disturbances, (1, n)."""
        return sum((output for part, output in self.outputs() if not part.disturbance), np.zeros_like(self.output))

    @cached_property
    def level_direction(self) -> Floats | None:
        """Return the constant change of the states (n,) that adds a constant 1 to y; None if there is none."""
        states, n = self._slices()[0], len(self.drift)
        for last in dict.fromkeys((0, states.stop - 1)):  # the level; then also the level that it returns to
            direction = np.zeros(n)
            direction[[0, last]] = 1.0
            constant = self.parts[0].recursion is None and not (self.drift @ direction).any()
            if constant and (self.output @ direction == 1.0).all():
                return frozen(direction)
        return None

    @property
    def keeps_level(self) -> bool:
        """Return whether a constant in y stays constant, so that any level may be subtracted from the readings."""
        return self.level_direction is not None

    @property
    def returns(self) -> bool:
        """Return whether the first part is a motion that is damped towards its last state, the level."""
        last = self._slices()[0].stop - 1
        return bool(last > 0 and self.drift[last, last] < 0.0 and self.keeps_level)

    @property
    def has_recursion(self) -> bool:
        """Return whether a part is defined only at whole steps."""
        return any(part.recursion is not None for part in self.parts)

    @cached_property
    def known(self) -> Floats | None:
        """Return the prior information on the states, an inverse covariance (n, n); None if there is none.

        A recursion is stationary; without this information, the first readings could not distinguish it from a motion.
        The distance of a motion from the level to which it returns is also stationary.
        """
        if not (self.has_recursion or self.returns):
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
                f"There is no Euler form of {names[0]}, which has even steps; use discretisation = 'exact'."
            )

    def _slices(self) -> list[slice]:
        bounds = np.cumsum([0, *(len(part.state_names) for part in self.parts)])
        return [slice(first, stop) for first, stop in pairwise(bounds.tolist())]

    def as_disturbance(self) -> Component:
        """Return the component as a disturbance: it is in the readings, but not in the signal."""
        return replace(self, parts=tuple(replace(part, disturbance=True) for part in self.parts))

    def __add__(self, other: Component) -> Component:
        """Join two independent components; their outputs add."""
        if not isinstance(other, Component):
            raise ModelError(f"{other!r:.60} is not a Component; add one, as motion(2, 1.0) + bias(1.0).")
        return Component(
            frozen(block_diagonal(self.drift, other.drift)),
            frozen(block_diagonal(self.noise_input, other.noise_input)),
            frozen(block_diagonal(self.noise_density, other.noise_density)),
            frozen(np.hstack([self.output, other.output])),
            self.parts + other.parts,
        )

    def over(self, steps_s: Floats) -> tuple[Floats, Floats]:
        """Integrate exactly over steps of several lengths (u,), in seconds; return F and Q, (u, n, n) each.

        Each part is integrated separately, so that a part keeps its digits if the noise of another is much larger.

        Raises
        ------
        ModelError
            If a part has even steps and a length is not a whole number of them.
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

    def to_model(
        self, step_s: float, noise_variance: float, discretisation: Literal["exact", "euler"] = "exact"
    ) -> Model:
        """Return the Model of one channel that measures y every `step_s` seconds.

        Parameters
        ----------
        step_s : float
            Step, in seconds.
        noise_variance : float
            R, the variance of the measurement noise, in unit^2.
        discretisation : {"exact", "euler"}
            "exact" integrates the noise over the step (module `discretisation`); "euler" is the first-order
            form F = I + T A, G = T B, which uses the density as the covariance of the noise of each step,
            as in the IMU paper.

        Raises
        ------
        ModelError
            If the step is not positive, the variance is negative or the discretisation has another name; or if a part
            has even steps, and `step_s` is not a whole number of them or the discretisation is "euler".
        """
        variance = checked_number("noise_variance", noise_variance, "a variance", "a number in unit^2", zero=True)
        return self._model(checked_step(step_s), variance, str(discretisation))

    @lru_cache(maxsize=256)  # noqa: B019  (a few hundred small matrices; a filter, its gate and its gap limit use the same)
    def _model(self, step_s: float, noise_variance: float, discretisation: str) -> Model:
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
    """Return the prior information (n + 1, n + 1) of a motion that is stationary about its last state, the level.

    There is no information on the level itself. All is zero if the stationary covariance cannot be computed.
    """
    from scipy.linalg import solve_continuous_lyapunov

    n = len(A) - 1
    to_distance, back = np.eye(n + 1), np.eye(n + 1)
    to_distance[0, n], back[0, n] = -1.0, 1.0  # the first state becomes its distance from the last
    own = (to_distance @ A @ back)[:n, :n]
    scale = balancing(own)
    P = solve_continuous_lyapunov(own / scale[:, np.newaxis] * scale, -W[:n, :n] / np.outer(scale, scale))
    Y = np.zeros((n + 1, n + 1))
    if np.isfinite(P).all() and (P.diagonal() > 0.0).all():
        Y[:n, :n] = np.linalg.inv(P) / np.outer(scale, scale)
    return np.asarray(to_distance.T @ Y @ to_distance)


def checked_number(name: str, value: object, what: str, needed: str, *, zero: bool = False) -> float:
    """Return a finite number above zero, or at least zero if zero is allowed, as float.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : object
        The value to check.
    what, needed : str
        Words for the message: what the value should be, and what to give; "or 0" is added if zero is allowed.
    zero : bool
        True if zero is allowed.

    Raises
    ------
    ModelError
        If it is not a number (booleans and text are not numbers), not finite, negative, or 0 where 0 is not allowed.
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
    """Return a whole number from 1 to `highest` as int; `refusal` is the end of the error message.

    Raises
    ------
    ModelError
        If it is not a whole number, or out of range.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 1 <= value <= highest:
        raise ModelError(f"{name} = {value!r} {refusal}")
    return int(value)


# Limits of magnitude beyond which a value is not a reading: from a record, from the noise, and from float64.

_FACTOR = 1e9  # largest distance of a reading from the median, over the spread: 30 bits, more than a converter has
_QUANTILE = 0.9  # quantile of the distances from the median that gives the spread
_ROUNDING = 1e3  # largest rounding error of a reading in float64, over the standard deviation of the noise


def find_largest(z: Floats) -> float:
    """Return the magnitude beyond which a value of a record is not a reading; 1e100 if all values may be readings.

    Parameters
    ----------
    z : (N,) float array
        Readings, in unit; NaN where missing. At most one in ten may be invalid.

    Notes
    -----
    The limit detects values that mark missing readings, such as 1e30, and damaged digits. Gates reject spikes.
    """
    usable = z[np.abs(z) <= BEYOND_ANY_SENSOR]
    distances = np.abs(usable - np.median(usable)) if len(usable) else usable
    distances = distances[distances > 0]
    if not len(distances):
        return BEYOND_ANY_SENSOR
    spread = float(np.quantile(distances, _QUANTILE))
    largest = abs(float(np.median(usable))) + _FACTOR * spread
    return largest if np.abs(usable).max() > largest else BEYOND_ANY_SENSOR


def largest_magnitude_for_noise(noise_variance: float) -> float:
    """Return the magnitude beyond which float64 rounds a value to more than 1000 standard deviations of the noise.

    A filter that used such a reading could not recover: later corrections would be lost in the rounding of its
    state. Without noise the limit is 1e100; it is never higher.

    Parameters
    ----------
    noise_variance : float
        R, in unit^2; with a *small* one the limit is lower.
    """
    if not noise_variance > 0:
        return BEYOND_ANY_SENSOR
    return min(_ROUNDING * float(np.sqrt(noise_variance)) / float(np.finfo(float).eps), BEYOND_ANY_SENSOR)


def largest_level(noise_variance: float) -> float:
    """Return the largest level whose rounding in float64 is smaller than the noise of this variance, in unit^2."""
    return largest_magnitude_for_noise(noise_variance) / _ROUNDING


def level_from_first_reading(reading: float, noise_variance: float) -> float:
    """Return the level to subtract from readings: the first reading, or 0 if its rounding would hide the noise."""
    return reading if abs(reading) <= largest_level(noise_variance) else 0.0
