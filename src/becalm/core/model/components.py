"""The components of a signal model: motion, tones, hum, coloured noise, bias; `+` joins them.

Each is a `Component`, a model in continuous time driven by white noise; see `becalm.core.model.parts`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from becalm.core.arrays import block_diagonal, frozen
from becalm.core.closed_forms import butterworth_poles
from becalm.core.model.autoregressive import autoregressive
from becalm.core.model.parts import Component, Part, checked_number, checked_whole

__all__ = [
    "EVERY_ORDER",
    "HIGHEST_ORDER",
    "LEVEL_RATE",
    "ORDERS",
    "Component",
    "Part",
    "autoregressive",
    "bias",
    "gauss_markov",
    "hum",
    "level",
    "motion",
    "oscillator",
    "returning_motion",
    "with_walking_level",
]

HIGHEST_ORDER = 5  # highest order of a motion

LEVEL_RATE = 0.1
"""Rate at which the level of a returning motion follows the signal, as a fraction of its damping."""

ORDERS = (1, 2, 3)
"""Orders of motion that identification tries for a causal filter."""

EVERY_ORDER = tuple(range(1, HIGHEST_ORDER + 1))
"""Orders of motion that identification tries for a smoother."""


def level(noise_density: float = 1.0) -> Component:
    """Return a random walk, a level that drifts.

    Parameters
    ----------
    noise_density : float
        Growth of the level's variance, in unit^2/s; a *small* one trusts the level to stay constant and smooths more.

    Raises
    ------
    ModelError
        If the density is negative or not finite.
    """
    return motion(1, noise_density)


def motion(order: int, noise_density: float = 1.0) -> Component:
    """Return the kinematic model of order n: white noise on the n-th derivative of the signal.

    Parameters
    ----------
    order : int
        1 is a random walk, 2 constant velocity, 3 constant acceleration; up to 5.
    noise_density : float
        Two-sided density of the noise on the n-th derivative, in unit^2/s^(2n-1); a *small* one
        trusts the polynomial and smooths more.

    Raises
    ------
    ModelError
        If the order is not 1 to 5 or the density is negative or not finite.

    Notes
    -----
    At high rates the steady-state filter is a low-pass with Butterworth's poles that also follows ramps; the cut-off is
    (density / (R T))^(1/2n) rad/s. Do not confuse this model with the piecewise-constant noise of
    Kalata's alpha-beta filter (IEEE TAES-20, 1984), whose process covariance has rank one.
    """
    refusal = f"is not offered; choose 1 (level) to {HIGHEST_ORDER}."
    return _motion(checked_whole("order", order, refusal, HIGHEST_ORDER), _density(noise_density))


@lru_cache(maxsize=256)  # a search needs the same components many times
def _motion(order: int, noise_density: float) -> Component:
    drift = np.eye(order, k=1)
    enters, sees = np.zeros((order, 1)), np.zeros((1, order))
    enters[-1, 0] = sees[0, 0] = 1.0
    part = Part("motion", ("level", "velocity", "acceleration", "jerk", "snap")[:order])
    return Component(frozen(drift), frozen(enters), frozen([[noise_density]]), frozen(sees), (part,))


def returning_motion(order: int, noise_density: float, damping: float) -> Component:
    """Return a kinematic model of order n that is damped towards a level, a mean of the past signal.

    Without readings the signal returns to the level, and its variance about the level is bounded.

    Parameters
    ----------
    order : int
        n, the number of integrations of the white noise, 1 to 5.
    noise_density : float
        Two-sided density of the noise, in unit^2/s^(2n-1); a *small* one trusts the model and smooths more.
    damping : float
        Cut-off a, in rad/s: motion at lower frequencies is damped; with a *small* one the signal returns slowly. For
        a towards 0 the model becomes `motion`.

    Raises
    ------
    ModelError
        If the order is not 1 to 5, the density is negative or not finite, or the damping is not positive.

    Notes
    -----
    The power of the model is q (w^2 + b^2) / (w^2 (w^2n + a^2n)): its distance from the level is white noise after a
    Butterworth low-pass. At frequencies above a the power is that of `motion`, so that both models smooth equally. The
    level follows the signal with the rate b = a / 10: it is a mean of the past signal with weights exp(-b t).
    """
    return _returning(
        motion(order, noise_density), checked_number("damping", damping, "a damping", "a positive number")
    )


@lru_cache(maxsize=256)
def _returning(kinematic: Component, damping: float) -> Component:
    n, level_rate = len(kinematic.drift), LEVEL_RATE * damping
    drift, enters, sees = np.zeros((n + 1, n + 1)), np.zeros((n + 1, 1)), np.zeros((1, n + 1))
    drift[:n, :n] = np.eye(n, k=1)
    drift[n - 1, :n] = -(np.poly(butterworth_poles(n)).real[:0:-1] * damping ** np.arange(n, 0, -1))
    drift[n - 1, n] = -drift[n - 1, 0]
    drift[[0, n], 0] += level_rate
    drift[[0, n], n] -= level_rate
    enters[n - 1, 0] = sees[0, 0] = 1.0
    part = Part("motion", (*kinematic.state_names, "level that it returns to"))
    return Component(frozen(drift), frozen(enters), kinematic.noise_density, frozen(sees), (part,))


def oscillator(frequency_hz: float, bandwidth_hz: float = 0.0, noise_density: float = 1.0) -> Component:
    """Return a damped oscillator whose amplitude and phase are driven by white noise: narrow-band noise.

    Parameters
    ----------
    frequency_hz : float
        Centre frequency, in hertz.
    bandwidth_hz : float
        Width of the resonance at half its power, in hertz. A *small* one trusts the tone to keep its phase. With 0 the
        oscillator is undamped: a tone whose amplitude and phase drift.
    noise_density : float
        Two-sided density of the noise on each of its two states, in unit^2/s; a *small* one trusts
        the tone and lets amplitude and phase change slowly. The standard deviation of a damped oscillator is
        sqrt(noise_density / (2 pi bandwidth_hz)).

    Raises
    ------
    ModelError
        If the frequency is not positive, or the width or the density is negative or not finite.

    Notes
    -----
    This is the stochastic cycle of Harvey (1989), section 2.3, in continuous time: (x, x*) rotates at
    2 pi f rad/s and decays at the rate pi B per second.
    """
    frequency_hz = checked_number("frequency_hz", frequency_hz, "a frequency", "a positive number of hertz")
    bandwidth_hz = checked_number("bandwidth_hz", bandwidth_hz, "a width", "a positive number of hertz", zero=True)
    noise_density = _density(noise_density)
    rotation, decay = 2 * np.pi * frequency_hz, np.pi * bandwidth_hz
    drift = [[-decay, rotation], [-rotation, -decay]]
    part = Part(f"oscillator at {frequency_hz:.4g} Hz", ("in phase", "in quadrature"))
    return Component(frozen(drift), frozen(np.eye(2)), frozen(noise_density * np.eye(2)), frozen([[1.0, 0.0]]), (part,))


def hum(mains_hz: float = 50.0, harmonics: int = 3, noise_density: float = 1.0) -> Component:
    """Return mains hum: undamped oscillators at the mains frequency and its harmonics; it is a disturbance.

    Parameters
    ----------
    mains_hz : float
        Mains frequency, in hertz: 50 or 60, or as measured.
    harmonics : int
        Number of tones, including the fundamental.
    noise_density : float
        Density of each `oscillator`, in unit^2/s; a *small* one trusts the tones to be steady.

    Raises
    ------
    ModelError
        If `harmonics` is below 1, or a frequency or density is not valid for `oscillator`.
    """
    mains_hz = checked_number("mains_hz", mains_hz, "a frequency", "a positive number of hertz")
    harmonics = checked_whole("harmonics", harmonics, "is not a number of tones; give a whole number, 1 or more.")
    tones = [oscillator(mains_hz * k, 0.0, noise_density) for k in range(1, harmonics + 1)]
    return sum(tones[1:], tones[0]).as_disturbance()


def gauss_markov(correlation_s: float, std: float = 1.0) -> Component:
    """Return noise with exponential correlation (first-order Gauss-Markov, Ornstein-Uhlenbeck).

    Parameters
    ----------
    correlation_s : float
        Time in which the correlation falls to 1/e, in seconds.
    std : float
        Standard deviation, in unit; a *small* one attributes more of the readings to the other components.

    Raises
    ------
    ModelError
        If the time is not positive or the standard deviation is negative or not finite.
    """
    correlation_s = checked_number("correlation_s", correlation_s, "a time", "a positive number of seconds")
    std = checked_number("std", std, "a standard deviation", "a positive number", zero=True)
    one, density = frozen([[1.0]]), frozen([[2 * std * std / correlation_s]])
    return Component(frozen([[-1 / correlation_s]]), one, density, one, (Part("Gauss-Markov noise", ("level",)),))


def bias(noise_density: float = 1.0) -> Component:
    """Return the bias of a sensor as a random walk; it is a disturbance.

    Parameters
    ----------
    noise_density : float
        Growth of the variance of the bias, in unit^2/s; a *small* one trusts the bias to stay constant.

    Raises
    ------
    ModelError
        If the density is negative or not finite.
    """
    part = Part("bias", ("bias",), disturbance=True)
    return replace(motion(1, noise_density), parts=(part,))


def with_walking_level(component: Component, noise_density: float) -> Component:
    """Return the component with a random walk added to the level of its motion; the other states do not change.

    Parameters
    ----------
    component : Component
        A motion, possibly with tones.
    noise_density : float
        Growth of the variance of the level, in unit^2/s; a *small* one trusts the slope to predict the level.

    Raises
    ------
    ModelError
        If the density is negative or not finite.
    """
    level = component.level_direction
    level = np.eye(len(component.drift))[:, :1] if level is None else level[:, np.newaxis]
    return replace(
        component,
        noise_input=frozen(np.hstack([component.noise_input, level])),
        noise_density=frozen(block_diagonal(component.noise_density, np.full((1, 1), _density(noise_density)))),
    )


def _density(noise_density: float) -> float:
    return checked_number("noise_density", noise_density, "a density", "a positive number", zero=True)
