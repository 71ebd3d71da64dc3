"""Choose the thresholds of the drift and dead-sensor alarms of a channel from the innovations on its tuning record."""

from __future__ import annotations

from functools import partial

import numpy as np

from becalm.cleaning.faults import FALSE_ALARMS_PER_HOUR
from becalm.cleaning.judging import InnovationJudge
from becalm.cleaning.recipe_parts import LimitsRecipe
from becalm.core.arrays import Floats
from becalm.core.health.monitor import SLACK, find_alarms
from becalm.identification.likelihood import Tuning
from becalm.identification.trust.tuning_spread import excess_error
from becalm.native.scans import MOST_SIGMA

MARGIN = 2.0
"""Least ratio of the drift threshold to the highest cumulative sum of the tuning record."""

COLOURED = 4.0
"""Largest drift threshold, as a multiple of that for white innovations; if they need more, there is no drift alarm."""


def with_alarms(
    limits: LimitsRecipe | None, tuning: Tuning, normalised: Floats, *, causal: bool, step_s: float
) -> LimitsRecipe | None:
    """Return the limits of a channel with the thresholds of its alarms, if its innovations determine them.

    Parameters
    ----------
    limits : LimitsRecipe or None
        Limits of the channel; None stays None.
    tuning : Tuning
        Filter of the channel, in steps.
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
        Unchanged if the innovations do not determine thresholds.

    Notes
    -----
    No row of the tuning record raises an alarm; only later rows that exceed it by a margin do. If the model does not
    describe the record, the innovations show the error of the model and determine no thresholds.
    """
    if limits is None:
        return None
    judge = InnovationJudge(step_s)
    judge.add(normalised, 1.0)
    judgement = judge.judgement(None if causal else partial(excess_error, tuning))
    if not judgement.describes or judgement.verdict == "untold":
        return limits
    alarms = find_alarms(FALSE_ALARMS_PER_HOUR, step_s, normalised)
    drift = max(alarms.drift_threshold, MARGIN * highest_sum(normalised))
    return limits.model_copy(
        update={
            "drift_threshold": drift if drift <= COLOURED * alarms.drift_threshold else None,
            "dead_variance": alarms.dead_variance or None,
        }
    )


def highest_sum(normalised: Floats) -> float:
    """Return the highest two-sided cumulative sum of normalised innovations (N,), in sigma, without restarts."""
    finite = normalised[np.isfinite(normalised)]
    highest = 0.0
    for sign in (1.0, -1.0):
        walk = np.cumsum(sign * np.clip(finite, -MOST_SIGMA, MOST_SIGMA) - SLACK)
        highest = max(highest, float((walk - np.minimum(np.minimum.accumulate(walk), 0.0)).max(initial=0.0)))
    return highest
