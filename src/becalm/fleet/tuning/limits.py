"""What all sensors of a class keep to while they are healthy: a limit of one alone would find faults in the others."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Literal, TypeVar

from becalm.cleaning.recipe_parts import LimitsRecipe
from becalm.fleet.tuning.found import TunedChannel

_FEWEST_AT_A_RAIL = 2  # sensors: what one alone reached may be its own
_SAME = 1e-9  # share by which two rails, or resolutions, may differ

_Side = Literal["low", "high"]
_Number = TypeVar("_Number", int, float)


def limits_of_class(alike: Sequence[TunedChannel], channels: Sequence[TunedChannel]) -> LimitsRecipe | None:
    """Return the limits of a channel of a class; None where its sensors tell of none.

    How long readings are held, and how far sums of innovations go, is told by the sensors that are alike: of what more
    than half of them tell, the least strict is taken. A rail is one of the class where two sensors or more reached it,
    and none went beyond it. A magnitude that is no reading is one wherever a sensor told it.

    Parameters
    ----------
    alike : sequence of TunedChannel
        Of the sensors that are typical of the class; one at least.
    channels : sequence of TunedChannel
        Of all of its sensors, of the same name and unit.
    """
    told = [channel.recipe.limits for channel in alike if channel.recipe.limits is not None]
    every = [channel.recipe.limits for channel in channels if channel.recipe.limits is not None]
    enough = len(alike) / 2
    limits = LimitsRecipe(
        low=_rail("low", channels),
        high=_rail("high", channels),
        resolution=_same([one.resolution for one in told]),
        rounding_std=max((one.rounding_std for one in told if one.rounding_std is not None), default=None),
        stuck_readings=_least_strict(max, [one.stuck_readings for one in told], enough),
        even_time=all(one.even_time for one in told),
        gap_steps=max((one.gap_steps for one in told if one.gap_steps is not None), default=None),
        largest=max((one.largest for one in every if one.largest is not None), default=None),
        outlier_distance=_least_strict(max, [one.outlier_distance for one in told], enough),
        causal_outlier_distance=_least_strict(max, [one.causal_outlier_distance for one in told], enough),
        plausible_low=_least_strict(min, [one.plausible_low for one in told], enough),
        plausible_high=_least_strict(max, [one.plausible_high for one in told], enough),
        repeats_are_one=all(one.repeats_are_one for one in told) or None,
        blank=_same([one.blank for one in told]),
        far_from_0=_least_strict(_farthest, [one.far_from_0 for one in told], enough),
        drift_threshold=_least_strict(max, [one.drift_threshold for one in told], enough),
        dead_variance=_least_strict(min, [one.dead_variance for one in told], enough),
    )
    readings = (limits.low, limits.high, limits.stuck_readings, limits.largest, limits.outlier_distance, limits.blank)
    nothing = readings == (None,) * len(readings)
    return None if nothing else limits  # of time, and of innovations, nothing is told alone


def _least_strict(
    choose: Callable[[Iterable[_Number]], _Number], told: Sequence[_Number | None], enough: float
) -> _Number | None:
    known = [one for one in told if one is not None]
    return choose(known) if len(known) > enough else None


def _farthest(told: Iterable[float]) -> float:
    """Return the greatest distance from 0; 0, which leaves none out, is the least strict."""
    known = sorted(told)
    return known[-1] if known[0] > 0 else 0.0


def _same(told: Sequence[float | None]) -> float | None:
    """Return what all tell; None where one tells something else, or nothing."""
    known = [one for one in told if one is not None]
    same = len(known) == len(told) and all(math.isclose(one, known[0], rel_tol=_SAME) for one in known)
    return known[0] if known and same else None


def _rail(side: _Side, channels: Sequence[TunedChannel]) -> float | None:
    """Return where the range of the sensors of a class ends; None where they do not tell."""
    told = [getattr(channel.recipe.limits, side, None) for channel in channels]
    rails = [float(rail) for rail in told if rail is not None]
    if not rails:
        return None
    rail = max(rails) if side == "high" else min(rails)
    reached = sum(math.isclose(one, rail, rel_tol=_SAME) for one in rails)
    beyond = [channel.highest - rail if side == "high" else rail - channel.lowest for channel in channels]
    passed = any(far > _SAME * abs(rail) for far in beyond)
    return rail if reached >= min(_FEWEST_AT_A_RAIL, len(channels)) and not passed else None
