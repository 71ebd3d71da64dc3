"""Convert the limits of a healthy sensor between recipes and the types of `becalm.core.health`."""

from __future__ import annotations

import numpy as np

from becalm.cleaning.recipes.recipe_parts import LimitsRecipe
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

_PARTS = 36  # default of `far_from_0`: the plausible range divided by this number
_LEAST_ROUNDING = 1e-3  # least quantisation error, as a share of the resolution, that is not ignored


def limits_recipe(limits: Limits) -> LimitsRecipe | None:
    """Return limits in the form of a recipe; None if there are only limits of times, or a resolution."""
    saturation = [float(limit) if np.isfinite(limit) else None for limit in limits.rails]
    largest = limits.largest if limits.largest < BEYOND_ANY_SENSOR else None
    rule = limits.outliers
    no_rule = np.isinf(rule.distance) and np.isinf(rule.blank)
    if saturation == [None, None] and limits.stuck_readings is None and largest is None and no_rule:
        return None
    return LimitsRecipe(
        low=saturation[0],
        high=saturation[1],
        resolution=limits.resolution or None,
        stuck_readings=limits.stuck_readings,
        even_time=limits.even,
        gap_steps=None if limits.gap_steps == GAP_STEPS else limits.gap_steps,
        largest=largest,
        outlier_distance=_finite(rule.distance),
        causal_outlier_distance=_finite(rule.causal_distance),
        plausible_low=_finite(rule.low),
        plausible_high=_finite(rule.high),
        repeats_are_one=rule.repeats_are_one or None,
        blank=_finite(rule.blank),
        far_from_0=None if np.isinf(rule.distance) else rule.far_from_0,
    )


def _finite(number: float) -> float | None:
    return float(number) if np.isfinite(number) else None


def _value_or(number: float | None, otherwise: float) -> float:
    return otherwise if number is None else number


def limits_of(entry: LimitsRecipe | None) -> Limits:
    """Return the limits of a recipe; for None, no reading counts as clipped or stuck, and no row as late."""
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
    """Return `far_from_0` in unit: a reading of 0 is missing if all neighbours are farther than this from 0.

    A recipe without this value gets one from its plausible range, but only if equal readings in a row count as one and
    gross outliers are rejected. Otherwise the result is 0.0, which keeps every reading of 0.
    """
    if limits.far_from_0 is not None or limits.plausible_low is None or limits.plausible_high is None:
        return limits.far_from_0 or 0.0
    has_default = limits.repeats_are_one and (limits.outlier_distance or limits.causal_outlier_distance)
    return (limits.plausible_high - limits.plausible_low) / _PARTS if has_default else 0.0


def outlier_test_rows(entry: LimitsRecipe | None, lag: int | None) -> int:
    """Return the number of later rows that the outlier test uses, for a lag in rows (None: a smoother)."""
    return rows_ahead(lag) if lag is None or np.isfinite(limits_of(entry).outliers.distance) else 0


def smoothing_rows(entry: LimitsRecipe | None, lag: int | None) -> int | None:
    """Return the number of rows of a lag that the filter smooths with after the outlier test; None for a smoother."""
    return None if lag is None else lag - outlier_test_rows(entry, lag)


def least_lag_s(entry: LimitsRecipe | None, wait_s: float, step_s: float) -> float:
    """Return the least lag, in seconds, of which `wait_s` remain for smoothing after the outlier test; inf for inf."""
    if not np.isfinite(wait_s):
        return wait_s
    wanted = lag = round(wait_s / step_s)
    while lag - outlier_test_rows(entry, lag) < wanted:
        lag += 1
    return lag * step_s


def alarms_of(entry: LimitsRecipe | None) -> Alarms:
    """Return the thresholds of the drift and dead-sensor alarms; an alarm is off if the recipe has no threshold."""
    drift = None if entry is None else entry.drift_threshold
    dead = None if entry is None else entry.dead_variance
    return Alarms(NEVER if drift is None else drift, dead or 0.0)


def with_rounding(
    limits: LimitsRecipe | None, tuning: Tuning, readings: Floats, *, causal: bool
) -> LimitsRecipe | None:
    """Return the limits of a channel, with the quantisation error that remains in the signal if it is noticeable.

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
    finite = readings[np.isfinite(readings)]
    std = rounding_left(finite, tuning.noise_variance, min(max(round(averaged), 1), max(len(finite) // 2, 1)))
    return limits.model_copy(update={"rounding_std": std}) if std > _LEAST_ROUNDING * limits.resolution else limits
