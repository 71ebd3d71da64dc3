"""What waiting for later readings gains: the curve from the filter over fixed lags to the smoother.

Predicted from the Riccati solution and the variance of a reading alone, as the front is.
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
from becalm.core.steady.steady_gain import steady
from becalm.errors import ModelError, UsageError
from becalm.identification.likelihood import Tuning

_WAITS = np.append(0.0, np.geomspace(0.05, 6.0, 40))  # in units of 1 / cut-off
_SHARES = (0.25, 0.5, 0.75)  # of the decibels that waiting gains
_NEAR_DB = 0.1
_LONGEST = 1 << 30  # readings


@dataclass(frozen=True)
class Wait:
    """What is left if the output may wait for later readings.

    Attributes
    ----------
    wait_s : float
        0 is the filter, inf the smoother.
    sigma : float
        Standard deviation of the error where the model holds, in unit.
    noise_std : float
        Standard deviation of a reading's noise that is left, in unit.
    gain_db : float
        How much less error power than the filter leaves, in dB.
    """

    wait_s: float
    sigma: float
    noise_std: float
    gain_db: float


def waiting_curve(
    order: int, ratio: float, noise_variance: float, step_s: float, waits: Sequence[int] | None = None
) -> tuple[Wait, ...]:
    """Return the curve from the filter over fixed lags to the smoother: what waiting for later readings gains.

    Parameters
    ----------
    order : int
        1 to 5.
    ratio : float
        q/r, as in `Tuning.ratio`; a *small* one trusts the motion, and waiting takes longer to pay.
    noise_variance : float
        r of a reading, in unit^2; with a *small* one less is left of everything, and waiting pays as much.
    step_s : float
        Step in seconds.
    waits : sequence of int, optional
        Later readings that are waited for; by default to 6 / cut-off. The smoother comes last in any case.

    Raises
    ------
    UsageError
        If the ratio or the variance is not positive, or a wait is negative.
    ModelError
        If there is no such order, or the step is not positive.
    """
    step_s = checked_step(step_s)
    if not 0 < ratio < np.inf:
        raise UsageError(f"ratio = {ratio} is no q/r; give a positive number, variance over variance.")
    if any(not wait >= 0 for wait in waits or ()):
        raise UsageError(f"waits = {waits} go back in time; give numbers of readings, no wait below 0.")
    refuse_variance(noise_variance)
    found = motion_filter(order, ratio)
    steps = np.unique(np.round(_WAITS / ratio_to_cutoff(order, ratio))) if waits is None else np.sort(np.asarray(waits))
    alone = found.error_variance()
    curve = []
    for wait in (*steps.tolist(), np.inf):
        error, noise = found.error_variance(wait), found.noise_gain(wait)
        sigma, left = np.sqrt(error * noise_variance), np.sqrt(noise * noise_variance)
        curve.append(Wait(wait * step_s, float(sigma), float(left), decibels(alone / error)))
    return tuple(curve)


@dataclass(frozen=True)
class Delay:
    """What is left of the noise if the output comes so much later.

    Attributes
    ----------
    wait_s : float
        Lag in seconds; 0 is the filter.
    sigma : float
        Standard deviation of the error where the model holds, in unit.
    left_db : float
        Its power over that of a reading's noise, in dB, below 0.
    """

    wait_s: float
    sigma: float
    left_db: float


def delay_curve(tuning: Tuning, step_s: float) -> tuple[Delay, ...]:
    """Return what a delay buys of a tuned filter, from none at all to where more would not gain 0.1 dB.

    Between them stand the least lags that gain a quarter, a half and three quarters of that.

    Parameters
    ----------
    tuning : Tuning
        Motion, tones and coloured noise; what is no signal, coloured noise among it, counts as noise of a reading.
    step_s : float
        Step in seconds.

    Returns
    -------
    tuple of Delay
        The soonest first; the last one is the limit, that of the smoother within 0.1 dB.

    Raises
    ------
    ModelError
        If the filter never settles, as without process noise, or the step is not positive.
    """
    coloured = 0.0 if tuning.coloured is None else tuning.coloured.variance
    return delays_of(tuning.component, tuning.noise_variance, tuning.noise_variance + coloured, step_s)


def delays_of(component: Component, noise_variance: float, noise: float, step_s: float) -> tuple[Delay, ...]:
    """Return that curve of a component, as of one mode of several: `noise` is all that a reading's noise counts."""
    step_s = checked_step(step_s)
    found = steady(component.to_model(1.0, noise_variance), component.signal_output[0])
    if not found.error_variance() > 0:
        raise ModelError(
            "Without process noise the error shrinks for ever, so that no delay can be told; give q above 0."
        )

    def left_db(lag: float) -> float:
        return decibels(found.error_variance(lag) / noise)

    first, limit = left_db(0), left_db(np.inf)
    wanted = [first + share * (limit - first) for share in _SHARES]
    lags = {0, *(_least_lag(left_db, level) for level in (*wanted, limit + _NEAR_DB) if level < first)}
    return tuple(Delay(lag * step_s, float(np.sqrt(found.error_variance(lag))), left_db(lag)) for lag in sorted(lags))


def _least_lag(left_db: Callable[[float], float], wanted: float) -> int:
    """Return the least lag at which no more than wanted is left; what is left never grows with it."""
    high = 1
    while left_db(high) > wanted and high < _LONGEST:
        high *= 2
    low = high // 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if left_db(middle) > wanted else (low, middle)
    return high


def refuse_variance(noise_variance: float) -> None:
    """Raise a UsageError if a number is not the variance of a reading."""
    if not 0 < noise_variance < np.inf:
        raise UsageError(f"noise_variance = {noise_variance} is no variance; give a positive number in unit^2.")
