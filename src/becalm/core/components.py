"""The catalogue of signals and disturbances: motion, oscillators, hum, Gauss-Markov, bias; `+` joins them.

A component is a continuous-time model dx/dt = A x + B w, y = C x, whose noise w is white with
spectral density W (two-sided, unit^2 s). It becomes a `Model` for a step length in `to_model`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.linalg import block_diag

from becalm.core.arrays import Floats, frozen
from becalm.core.discretisation import discretise
from becalm.core.model import Model
from becalm.errors import ModelError

HIGHEST_ORDER = 5

ORDERS = (1, 2, 3)
"""Orders of motion that a causal filter is chosen from."""

EVERY_ORDER = tuple(range(1, HIGHEST_ORDER + 1))
"""Orders of motion that a smoother is chosen from."""


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
    """

    name: str
    state_names: tuple[str, ...]
    disturbance: bool = False


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
        W: spectral density of w; a *small* one trusts the model and smooths more.
    output : (1, n) float array
        C in y = C x.
    parts : tuple of Part
        What the states are, in their order.
    """

    drift: Floats
    noise_input: Floats
    noise_density: Floats
    output: Floats
    parts: tuple[Part, ...]

    @property
    def state_names(self) -> tuple[str, ...]:
        """What each state is."""
        return tuple(name for part in self.parts for name in part.state_names)

    @property
    def signal_output(self) -> Floats:
        """The output without the disturbances, (1, n)."""
        return sum((output for part, output in self.outputs() if not part.disturbance), np.zeros_like(self.output))

    @property
    def keeps_level(self) -> bool:
        """Whether whatever is added to the first state stays, and is added to y."""
        return bool(self.output[0, 0] == 1.0 and not self.drift[:, 0].any())

    def outputs(self) -> list[tuple[Part, Floats]]:
        """Split the output: return each part with the row (1, n) that gives its share of y."""
        rows = []
        for part, states in zip(self.parts, self._slices(), strict=True):
            own = np.zeros_like(self.output)
            own[:, states] = self.output[:, states]
            rows.append((part, own))
        return rows

    def _slices(self) -> list[slice]:
        bounds = np.cumsum([0, *(len(part.state_names) for part in self.parts)])
        return [slice(first, stop) for first, stop in pairwise(bounds.tolist())]

    def as_disturbance(self) -> Component:
        """Return the component as one that is read, but is no part of the signal."""
        return replace(self, parts=tuple(replace(part, disturbance=True) for part in self.parts))

    def __add__(self, other: Component) -> Component:
        """Join two independent components; their outputs add."""
        return Component(
            frozen(block_diag(self.drift, other.drift)),
            frozen(block_diag(self.noise_input, other.noise_input)),
            frozen(block_diag(self.noise_density, other.noise_density)),
            frozen(np.hstack([self.output, other.output])),
            self.parts + other.parts,
        )

    def over(self, steps_s: Floats) -> tuple[Floats, Floats]:
        """Integrate exactly over steps of several lengths (u,), in seconds; return F and Q, (u, n, n) each.

        Part by part, so that each keeps its own digits, however small its noise is beside another's.
        """
        W = self.noise_input @ self.noise_density @ self.noise_input.T
        F, Q = np.zeros((2, len(steps_s), *W.shape))
        for states in self._slices():
            own = np.index_exp[:, states, states]
            F[own], Q[own] = discretise(self.drift[states, states], W[states, states], steps_s)
        return F, Q

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
        F, Q = self.over(np.array([step_s]))
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
    _refuse_density(noise_density)
    drift = np.eye(order, k=1)
    enters, sees = np.zeros((order, 1)), np.zeros((1, order))
    enters[-1, 0] = sees[0, 0] = 1.0
    part = Part("motion", ("level", "velocity", "acceleration", "jerk", "snap")[:order])
    return Component(frozen(drift), frozen(enters), frozen([[noise_density]]), frozen(sees), (part,))


def oscillator(frequency_hz: float, bandwidth_hz: float = 0.0, noise_density: float = 1.0) -> Component:
    """Return a damped oscillation whose amplitude and phase are driven by white noise: noise of a narrow band.

    Parameters
    ----------
    frequency_hz : float
        Where it oscillates.
    bandwidth_hz : float
        Width of the resonance at half its power; 0 is undamped: a tone that wanders.
    noise_density : float
        Two-sided density of the noise on each of its two states, in unit^2/s; a *small* one trusts
        the tone and lets amplitude and phase change slowly. A damped one has the standard deviation
        sqrt(noise_density / (2 pi bandwidth_hz)).

    Raises
    ------
    ModelError
        If the frequency is not positive, or the width or the density is negative or not finite.

    Notes
    -----
    The stochastic cycle of Harvey (1989), section 2.3, in continuous time: (x, x*) turns by
    2 pi f a second and shrinks by pi B a second.
    """
    if not (0 < frequency_hz < np.inf):
        raise ModelError(f"frequency_hz = {frequency_hz} is not a frequency; give a positive number.")
    if not (0 <= bandwidth_hz < np.inf):
        raise ModelError(f"bandwidth_hz = {bandwidth_hz} is not a width; give 0 or a positive number.")
    _refuse_density(noise_density)
    turning, shrinking = 2 * np.pi * frequency_hz, np.pi * bandwidth_hz
    drift = [[-shrinking, turning], [-turning, -shrinking]]
    part = Part(f"oscillator at {frequency_hz:.4g} Hz", ("in phase", "in quadrature"))
    return Component(frozen(drift), frozen(np.eye(2)), frozen(noise_density * np.eye(2)), frozen([[1.0, 0.0]]), (part,))


def hum(mains_hz: float = 50.0, harmonics: int = 3, noise_density: float = 1.0) -> Component:
    """Return mains hum, a disturbance: undamped oscillators at the mains frequency and its harmonics.

    Parameters
    ----------
    mains_hz : float
        50 or 60, or as measured.
    harmonics : int
        How many tones, the fundamental among them.
    noise_density : float
        As of each `oscillator`; a *small* one trusts the tones to be steady.

    Raises
    ------
    ModelError
        If there is no tone, or an oscillator would refuse its numbers.
    """
    if harmonics < 1:
        raise ModelError(f"harmonics = {harmonics} leaves no tone; give 1 or more.")
    tones = [oscillator(mains_hz * k, 0.0, noise_density) for k in range(1, harmonics + 1)]
    return sum(tones[1:], tones[0]).as_disturbance()


def gauss_markov(correlation_s: float, std: float = 1.0) -> Component:
    """Return noise that forgets exponentially (first-order Gauss-Markov, Ornstein-Uhlenbeck).

    Parameters
    ----------
    correlation_s : float
        Time after which 1/e of it is left, in seconds.
    std : float
        Its standard deviation, in unit; a *small* one leaves more to the other components.

    Raises
    ------
    ModelError
        If the time is not positive or the standard deviation is negative or not finite.
    """
    if not (0 < correlation_s < np.inf):
        raise ModelError(f"correlation_s = {correlation_s} is not a time; give a positive number of seconds.")
    if not (0 <= std < np.inf):
        raise ModelError(f"std = {std} is not a standard deviation; give 0 or a positive number.")
    one, density = frozen([[1.0]]), frozen([[2 * std**2 / correlation_s]])
    return Component(frozen([[-1 / correlation_s]]), one, density, one, (Part("Gauss-Markov noise", ("level",)),))


def bias(noise_density: float = 1.0) -> Component:
    """Return a sensor's bias, a disturbance that walks randomly with `noise_density` in unit^2/s."""
    part = Part("bias", ("bias",), disturbance=True)
    return replace(motion(1, noise_density), parts=(part,))


def _refuse_density(noise_density: float) -> None:
    if not (0 <= noise_density < np.inf):
        raise ModelError(f"noise_density = {noise_density} is not a density; give 0 or a positive number.")
