"""From which innovations on a channel drifts, or is dead: told by those of the record that it was tuned on."""

from __future__ import annotations

from functools import partial

import numpy as np

from becalm.cleaning.faults import FALSE_ALARMS_PER_HOUR
from becalm.cleaning.judging import InnovationJudge
from becalm.cleaning.recipe_parts import LimitsRecipe
from becalm.core.arrays import Floats
from becalm.core.health.cusum import SLACK
from becalm.core.health.monitor import find_alarms
from becalm.identification.likelihood import Tuning
from becalm.identification.trust.excess import excess_error
from becalm.native.scans import MOST_SIGMA

MARGIN = 2.0
"""Of the threshold over what the sums of the record itself reached."""

COLOURED = 4.0
"""Times the threshold of white noise: what needs a higher one is coloured too much for a drift to be told."""


def with_alarms(
    limits: LimitsRecipe | None, tuning: Tuning, normalised: Floats, *, causal: bool, step_s: float
) -> LimitsRecipe | None:
    """Add to the limits of a channel when it drifts, and when it is dead, where its innovations can tell.

    Parameters
    ----------
    limits : LimitsRecipe or None
        Of a channel that has none nothing more is told.
    tuning : Tuning
        Its filter, in steps.
    normalised : (N,) float array
        The filter's innovations on the record that it was tuned on, over their standard deviations; NaN where no
        reading was used.
    causal : bool
        Whether the filter shall run causally.
    step_s : float
        One step, in seconds.

    Returns
    -------
    LimitsRecipe or None
        As they came where the innovations do not tell.

    Notes
    -----
    Nothing in the record itself is called a drift or dead; only what goes beyond it later, by a margin. Where the
    model does not describe the record, innovations tell of it, and not of the sensor.
    """
    if limits is None:
        return None
    judge = InnovationJudge(step_s)
    judge.add(normalised, 1.0)
    found = judge.judgement(None if causal else partial(excess_error, tuning))
    if not found.describes or found.verdict == "untold":
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
    """Return how far the two-sided cumulative sum of innovations (N,) went, in sigma, without an alarm."""
    known = normalised[np.isfinite(normalised)]
    highest = 0.0
    for sign in (1.0, -1.0):
        walk = np.cumsum(sign * np.clip(known, -MOST_SIGMA, MOST_SIGMA) - SLACK)
        highest = max(highest, float((walk - np.minimum(np.minimum.accumulate(walk), 0.0)).max(initial=0.0)))
    return highest
