"""Choose the thresholds of a channel's drift and dead-sensor alarms from the innovations on its tuning record."""

from __future__ import annotations

from functools import partial

import numpy as np

from becalm.cleaning.channels.faults import FALSE_ALARMS_PER_HOUR
from becalm.cleaning.channels.judging import InnovationJudge
from becalm.cleaning.recipes.recipe_parts import LimitsRecipe
from becalm.core.arrays import Floats
from becalm.core.health.monitor import SLACK, find_alarms
from becalm.identification.likelihood import Tuning
from becalm.identification.trust.tuning_spread import excess_error
from becalm.native.scans import MOST_SIGMA

DRIFT_MARGIN = 2.0
"""Least ratio of the drift threshold to the highest cumulative sum of innovations on the tuning record."""

MOST_DRIFT_RATIO = 4.0
"""Largest ratio of the drift threshold to that for white innovations; with a larger one the drift alarm is off."""


def with_alarms(
    limits: LimitsRecipe | None, tuning: Tuning, normalised: Floats, *, causal: bool, step_s: float
) -> LimitsRecipe | None:
    """Add the thresholds of the drift and dead-sensor alarms to the limits of a channel, if they can be determined.

    Parameters
    ----------
    limits : LimitsRecipe or None
        Limits of the channel; None stays None.
    tuning : Tuning
        Parameters of the channel's model; times in steps.
    normalised : (N,) float array
        Innovations of the filter on its tuning record, divided by their standard deviations; NaN where no reading was
        used.
    causal : bool
        Whether the filter runs causally.
    step_s : float
        One step, in seconds.

    Returns
    -------
    LimitsRecipe or None
        A copy of `limits` with the thresholds; `limits` itself if the innovations do not determine thresholds.

    Notes
    -----
    The tuning record itself raises no alarm: the drift threshold is at least `DRIFT_MARGIN` times the highest
    cumulative sum on it, and the dead-sensor threshold is below its quietest window. If the model does not describe
    the record, its innovations contain the error of the model and determine no thresholds.
    """
    if limits is None:
        return None
    judge = InnovationJudge(step_s)
    judge.add(normalised, 1.0)
    judgement = judge.judgement(None if causal else partial(excess_error, tuning))
    if not judgement.describes or judgement.verdict == "untold":
        return limits
    alarms = find_alarms(FALSE_ALARMS_PER_HOUR, step_s, normalised)
    drift = max(alarms.drift_threshold, DRIFT_MARGIN * highest_cusum(normalised))
    return limits.model_copy(
        update={
            "drift_threshold": drift if drift <= MOST_DRIFT_RATIO * alarms.drift_threshold else None,
            "dead_variance": alarms.dead_variance or None,
        }
    )


def highest_cusum(normalised: Floats) -> float:
    """Return the highest two-sided CUSUM, in sigma, of normalised innovations (N,), without a reset after alarms."""
    finite = normalised[np.isfinite(normalised)]
    highest = 0.0
    for sign in (1.0, -1.0):
        sums = np.cumsum(sign * np.clip(finite, -MOST_SIGMA, MOST_SIGMA) - SLACK)
        highest = max(highest, float((sums - np.minimum(np.minimum.accumulate(sums), 0.0)).max(initial=0.0)))
    return highest
