"""Convert the limits of a healthy sensor between a recipe and the core."""

from __future__ import annotations

import numpy as np

from becalm.cleaning.recipe_parts import LimitsRecipe
from becalm.core.arrays import Floats
from becalm.core.health.limits import Limits
from becalm.core.health.look_ahead import rows_ahead
from becalm.core.health.monitor import NEVER, Alarms
from becalm.core.health.outlier_rule import Outliers
from becalm.core.health.quantisation import rounding_left
from becalm.core.reading_verdicts import BEYOND_ANY_SENSOR
from becalm.core.time.clock import GAP_STEPS
from becalm.identification.likelihood import Tuning
from becalm.identification.trust.tuning_spread import independence_steps

_PARTS = 36  # a channel that comes closer to 0 than this fraction of its plausible range may rest there
_LEAST_ROUNDING = 1e-3  # of the resolution; a smaller error is left out


def limits_recipe(limits: Limits) -> LimitsRecipe | None:
    """Return limits in the form of a recipe; None if there are only limits of the time, or a resolution."""
    rails = [float(rail) if np.isfinite(rail) else None for rail in limits.rails]
    largest = limits.largest if limits.largest < BEYOND_ANY_SENSOR else None
    jumps = limits.outliers
    none_jumps = np.isinf(jumps.distance) and np.isinf(jumps.blank)
    if rails == [None, None] and limits.stuck_readings is None and largest is None and none_jumps:
        return None
    return LimitsRecipe(
        low=rails[0],
        high=rails[1],
        resolution=limits.resolution or None,
        stuck_readings=limits.stuck_readings,
        even_time=limits.even,
        gap_steps=None if limits.gap_steps == GAP_STEPS else limits.gap_steps,
        largest=largest,
        outlier_distance=_finite(jumps.distance),
        causal_outlier_distance=_finite(jumps.causal_distance),
        plausible_low=_finite(jumps.low),
        plausible_high=_finite(jumps.high),
        repeats_are_one=jumps.repeats_are_one or None,
        blank=_finite(jumps.blank),
        far_from_0=None if np.isinf(jumps.distance) else jumps.far_from_0,
    )


def _finite(number: float) -> float | None:
    return float(number) if np.isfinite(number) else None


def _value_or(number: float | None, otherwise: float) -> float:
    return otherwise if number is None else number


def limits_of(entry: LimitsRecipe | None) -> Limits:
    """Return the limits of a recipe; if it has none, no reading is clipped or stuck, and no row is late."""
    if entry is None:
        return Limits(even=False)
    return Limits(
        low=_value_or(entry.low, -np.inf),
        high=_value_or(entry.high, np.inf),
        resolution=entry.resolution or 0.0,
        stuck_readings=entry.stuck_readings,
        gap_steps=entry.gap_steps or GAP_STEPS,
        even=bool(entry.even_time),
        largest=entry.largest or BEYOND_ANY_SENSOR,
        outliers=Outliers(
            entry.outlier_distance or np.inf,
            entry.causal_outlier_distance or np.inf,
            _value_or(entry.plausible_low, -np.inf),
            _value_or(entry.plausible_high, np.inf),
            bool(entry.repeats_are_one),
            _value_or(entry.blank, np.inf),
            _far_from_0(entry),
        ),
    )


def _far_from_0(limits: LimitsRecipe) -> float:
    """Return the distance from 0, in unit: a 0 whose neighbours are all farther away is missing; 0.0 if none is.

    For recipes without this value, it comes from the plausible range if equal readings in a row count as one and gross
    outliers are found.
    """
    if limits.far_from_0 is not None or limits.plausible_low is None or limits.plausible_high is None:
        return limits.far_from_0 or 0.0
    judged = limits.repeats_are_one and (limits.outlier_distance or limits.causal_outlier_distance)
    return (limits.plausible_high - limits.plausible_low) / _PARTS if judged else 0.0


def rows_that_judge(entry: LimitsRecipe | None, lag: int | None) -> int:
    """Return how many later rows the outlier test uses, for a lag in rows (None: a smoother)."""
    return rows_ahead(lag) if lag is None or np.isfinite(limits_of(entry).outliers.distance) else 0


def rows_that_smooth(entry: LimitsRecipe | None, lag: int | None) -> int | None:
    """Return how many rows of a lag the outlier test leaves to smooth with; None for a smoother."""
    return None if lag is None else lag - rows_that_judge(entry, lag)


def delay_to_smooth(entry: LimitsRecipe | None, wait_s: float, step_s: float) -> float:
    """Return the least lag, in seconds, that leaves `wait_s` to smooth with after the outlier test; inf for inf."""
    if not np.isfinite(wait_s):
        return wait_s
    wanted = lag = round(wait_s / step_s)
    while lag - rows_that_judge(entry, lag) < wanted:
        lag += 1
    return lag * step_s


def alarms_of(entry: LimitsRecipe | None) -> Alarms:
    """Return the thresholds of the drift and dead-sensor alarms; an alarm without a threshold is off."""
    drift = None if entry is None else entry.drift_threshold
    dead = None if entry is None else entry.dead_variance
    return Alarms(NEVER if drift is None else drift, dead or 0.0)


def with_rounding(
    limits: LimitsRecipe | None, tuning: Tuning, readings: Floats, *, causal: bool
) -> LimitsRecipe | None:
    """Return the limits of a channel with the quantisation error that remains in the signal, if it is noticeable.

    Parameters
    ----------
    limits : LimitsRecipe or None
        Limits of the channel; None stays None.
    tuning : Tuning
        Filter of the channel, in steps.
    readings : (N,) float array
        Readings that the filter was tuned on, in unit; NaN where missing.
    causal : bool
        Whether the filter runs causally.
    """
    if limits is None or limits.resolution is None:
        return limits
    averaged = independence_steps(tuning, causal) or 1.0
    seen = readings[np.isfinite(readings)]
    left = rounding_left(seen, tuning.noise_variance, min(max(round(averaged), 1), max(len(seen) // 2, 1)))
    return limits.model_copy(update={"rounding_std": left}) if left > _LEAST_ROUNDING * limits.resolution else limits
