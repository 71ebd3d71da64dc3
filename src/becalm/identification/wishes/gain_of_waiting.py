"""Compute the gain of waiting for later readings: the curve from the filter over fixed lags to the smoother.

Like the trade-off curve, the gain is predicted from the Riccati solution and the noise variance of a reading alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from becalm.core.closed_forms import ratio_to_cutoff
from becalm.core.model.components import Component
from becalm.core.model.parts import checked_step
from becalm.core.steady.dials import motion_filter
from becalm.core.steady.response import decibels
from becalm.core.steady.steady_filter import steady
from becalm.errors import ModelError, UsageError
from becalm.identification.likelihood import Tuning

_WAITS = np.append(0.0, np.geomspace(0.05, 6.0, 40))  # default waits, in units of 1 / cut-off
_SHARES = (0.25, 0.5, 0.75)  # shares of the gain in dB from filter to smoother at which the curve has points
_NEAR_DB = 0.1  # distance from the smoother, in dB, at which the curve ends
_LONGEST = 1 << 30  # longest lag, in readings


@dataclass(frozen=True)
class Wait:
    """The remaining error if the output waits for later readings.

    Attributes
    ----------
    wait_s : float
        Waiting time in seconds; 0 is the filter, inf the smoother.
    sigma : float
        Standard deviation of the error where the model holds, in unit.
    noise_std : float
        Standard deviation of the part of a reading's noise that remains, in unit.
    gain_db : float
        Reduction of the error power compared with the filter, in dB.
    """

    wait_s: float
    sigma: float
    noise_std: float
    gain_db: float


def waiting_curve(
    order: int, ratio: float, noise_variance: float, step_s: float, waits: Sequence[int] | None = None
) -> tuple[Wait, ...]:
    """Return the gain of waiting for later readings, from the filter over fixed lags to the smoother.

    Parameters
    ----------
    order : int
        1 to 5.
    ratio : float
        q/r, as in `Tuning.ratio`; a *small* one trusts the motion, and longer waits are useful.
    noise_variance : float
        r, the noise variance of a reading, in unit^2; all errors are proportional to its root, and `gain_db` does not
        depend on it.
    step_s : float
        Step in seconds.
    waits : sequence of int, optional
        Numbers of later readings to wait for; by default up to 6 / cut-off. The smoother always comes last.

    Raises
    ------
    UsageError
        If the ratio or the variance is not positive, or a wait is negative or not whole.
    ModelError
        If there is no such order, or the step is not positive.
    """
    step_s = checked_step(step_s)
    if not 0 < ratio < np.inf:
        raise UsageError(f"ratio = {ratio} is not a q/r; give a positive number, variance over variance.")
    given = () if waits is None else waits
    if not all(wait >= 0 for wait in given):
        raise UsageError(f"waits = {waits} contains a negative wait; give numbers of readings, 0 or more.")
    if not all(float(wait).is_integer() for wait in given):
        raise UsageError(f"waits = {waits} contains a part of a reading; give whole numbers, 0 or more.")
    check_noise_variance(noise_variance)
    steady_filter = motion_filter(order, ratio)
    steps = np.unique(np.round(_WAITS / ratio_to_cutoff(order, ratio))) if waits is None else np.sort(np.asarray(waits))
    filter_error = steady_filter.error_variance()
    curve = []
    for wait in (*steps.tolist(), np.inf):
        error, noise = steady_filter.error_variance(wait), steady_filter.noise_gain(wait)
        sigma, noise_std = np.sqrt(error * noise_variance), np.sqrt(noise * noise_variance)
        curve.append(Wait(wait * step_s, float(sigma), float(noise_std), decibels(filter_error / error)))
    return tuple(curve)


@dataclass(frozen=True)
class Delay:
    """The remaining error if the output is delayed.

    Attributes
    ----------
    wait_s : float
        Lag in seconds; 0 is the filter.
    sigma : float
        Standard deviation of the error where the model holds, in unit.
    left_db : float
        Power of the error over that of a reading's noise, in dB.
    """

    wait_s: float
    sigma: float
    left_db: float


def delay_curve(tuning: Tuning, step_s: float) -> tuple[Delay, ...]:
    """Return the error of a tuned filter at several delays, from none to one within 0.1 dB of the smoother.

    In between are the smallest delays that reach a quarter, a half and three quarters of the smoother's gain in dB.

    Parameters
    ----------
    tuning : Tuning
        Motion, tones and coloured noise; coloured noise counts as noise of a reading.
    step_s : float
        Step in seconds.

    Returns
    -------
    tuple of Delay
        The curve, shortest delay first; the last one is within 0.1 dB of the smoother.

    Raises
    ------
    ModelError
        If the filter has no steady state, as without process noise, or the step is not positive.
    """
    coloured = 0.0 if tuning.coloured is None else tuning.coloured.variance
    return delays_of(tuning.component, tuning.noise_variance, tuning.noise_variance + coloured, step_s)


def delays_of(component: Component, noise_variance: float, noise: float, step_s: float) -> tuple[Delay, ...]:
    """Return the delay curve of a component, such as that of one mode of several.

    Parameters
    ----------
    component : Component
        The model of the signal and its disturbances, in steps.
    noise_variance : float
        R, in unit^2.
    noise : float
        Variance, in unit^2, of all that counts as a reading's noise, coloured noise included.
    step_s : float
        Step in seconds.

    Raises
    ------
    ModelError
        If the filter has no steady state, as without process noise, or the step is not positive.
    """
    step_s = checked_step(step_s)
    steady_filter = steady(component.to_model(1.0, noise_variance), component.signal_output[0])
    if not steady_filter.error_variance() > 0:
        raise ModelError(
            "Without process noise the error shrinks for ever, so there is no delay curve; give q above 0."
        )

    def left_db(lag: float) -> float:
        return decibels(steady_filter.error_variance(lag) / noise)

    first, limit = left_db(0), left_db(np.inf)
    wanted = [first + share * (limit - first) for share in _SHARES]
    lags = {0, *(_least_lag(left_db, level) for level in (*wanted, limit + _NEAR_DB) if level < first)}
    return tuple(
        Delay(lag * step_s, float(np.sqrt(steady_filter.error_variance(lag))), left_db(lag)) for lag in sorted(lags)
    )


def _least_lag(left_db: Callable[[float], float], wanted: float) -> int:
    """Return the smallest lag at which at most `wanted` dB remain; the error never grows with the lag."""
    high = 1
    while left_db(high) > wanted and high < _LONGEST:
        high *= 2
    low = high // 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if left_db(middle) > wanted else (low, middle)
    return high


def check_noise_variance(noise_variance: float) -> None:
    """Raise a UsageError if a noise variance is not positive and finite."""
    if not 0 < noise_variance < np.inf:
        raise UsageError(f"noise_variance = {noise_variance} is not a variance; give a positive number in unit^2.")
