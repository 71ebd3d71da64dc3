"""What waiting for later readings gains: the curve from the filter over fixed lags to the smoother.

Predicted from the Riccati solution and the variance of a reading alone, as the front is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from becalm.core.closed_forms import ratio_to_cutoff
from becalm.core.dials import motion_filter
from becalm.core.parts import checked_step
from becalm.core.response import decibels
from becalm.errors import UsageError

_WAITS = np.append(0.0, np.geomspace(0.05, 6.0, 40))  # in units of 1 / cut-off


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


def refuse_variance(noise_variance: float) -> None:
    """Raise a UsageError if a number is not the variance of a reading."""
    if not 0 < noise_variance < np.inf:
        raise UsageError(f"noise_variance = {noise_variance} is no variance; give a positive number in unit^2.")
