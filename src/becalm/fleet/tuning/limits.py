"""Join the limits of a class's sensors: with the limits of one sensor, the others would have false faults."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Literal, TypeVar

from becalm.cleaning.recipes.recipe_parts import LimitsRecipe
from becalm.fleet.tuning.sensor_tuning import TunedChannel

_FEWEST_AT_A_RAIL = 2  # sensors that must reach a saturation limit of the class; a single one may be special
_SAME = 1e-9  # relative difference at which two saturation limits, or resolutions, count as equal

_Side = Literal["low", "high"]
_Number = TypeVar("_Number", int, float)


def limits_of_class(alike: Sequence[TunedChannel], channels: Sequence[TunedChannel]) -> LimitsRecipe | None:
    """Return the limits of a channel of a class; None if its sensors have none.

    Most limits, such as the longest run of equal readings and the largest sum of innovations, come from the typical
    sensors: if more than half of these have a limit, the class gets the least strict of their values. The class has a
    saturation limit if at least two sensors reached it and none exceeded it. It has a largest valid magnitude
    (`largest`) if at least one sensor has one.

    Parameters
    ----------
    alike : sequence of TunedChannel
        This channel of each typical sensor (`class_recipe.alike_in`); at least one.
    channels : sequence of TunedChannel
        This channel of each sensor of the class that has it, with the same name and unit.
    """
    own = [channel.recipe.limits for channel in alike if channel.recipe.limits is not None]
    every = [channel.recipe.limits for channel in channels if channel.recipe.limits is not None]
    enough = len(alike) / 2
    limits = LimitsRecipe(
        low=_rail("low", channels),
        high=_rail("high", channels),
        resolution=_same([one.resolution for one in own]),
        rounding_std=max((one.rounding_std for one in own if one.rounding_std is not None), default=None),
        stuck_readings=_least_strict(max, [one.stuck_readings for one in own], enough),
        even_time=all(one.even_time for one in own),
        gap_steps=max((one.gap_steps for one in own if one.gap_steps is not None), default=None),
        largest=max((one.largest for one in every if one.largest is not None), default=None),
        outlier_distance=_least_strict(max, [one.outlier_distance for one in own], enough),
        causal_outlier_distance=_least_strict(max, [one.causal_outlier_distance for one in own], enough),
        plausible_low=_least_strict(min, [one.plausible_low for one in own], enough),
        plausible_high=_least_strict(max, [one.plausible_high for one in own], enough),
        repeats_are_one=all(one.repeats_are_one for one in own) or None,
        blank=_same([one.blank for one in own]),
        far_from_0=_least_strict(_farthest, [one.far_from_0 for one in own], enough),
        drift_threshold=_least_strict(max, [one.drift_threshold for one in own], enough),
        dead_variance=_least_strict(min, [one.dead_variance for one in own], enough),
    )
    readings = (limits.low, limits.high, limits.stuck_readings, limits.largest, limits.outlier_distance, limits.blank)
    nothing = readings == (None,) * len(readings)
    return None if nothing else limits  # other limits, such as gap_steps, are not written alone


def _least_strict(
    choose: Callable[[Iterable[_Number]], _Number], values: Sequence[_Number | None], enough: float
) -> _Number | None:
    present = [one for one in values if one is not None]
    return choose(present) if len(present) > enough else None


def _farthest(distances: Iterable[float]) -> float:
    """Return the least strict distance from 0: 0 if it occurs, because 0 rejects nothing; else the greatest."""
    ordered = sorted(distances)
    return ordered[-1] if ordered[0] > 0 else 0.0


def _same(values: Sequence[float | None]) -> float | None:
    """Return the common value of all; None if one differs or is missing."""
    present = [one for one in values if one is not None]
    same = len(present) == len(values) and all(math.isclose(one, present[0], rel_tol=_SAME) for one in present)
    return present[0] if present and same else None


def _rail(side: _Side, channels: Sequence[TunedChannel]) -> float | None:
    """Return a saturation limit of the class; None if too few sensors reached it, or one exceeded it."""
    limits = [getattr(channel.recipe.limits, side, None) for channel in channels]
    rails = [float(rail) for rail in limits if rail is not None]
    if not rails:
        return None
    rail = max(rails) if side == "high" else min(rails)
    reached = sum(math.isclose(one, rail, rel_tol=_SAME) for one in rails)
    beyond = [channel.highest - rail if side == "high" else rail - channel.lowest for channel in channels]
    passed = any(far > _SAME * abs(rail) for far in beyond)
    return rail if reached >= min(_FEWEST_AT_A_RAIL, len(channels)) and not passed else None
