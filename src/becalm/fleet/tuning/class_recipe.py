"""Make the recipe of a class. Each channel is copied from the most typical sensor, so that it fits at least this one.

The recipe has the channels, by name and unit, that more than half of the tuned sensors of the class have. A channel is
chosen in four steps:

1. The candidates are the sensors whose own filter describes the channel. If there are none, they are the sensors that
   filter the channel; if none does, they are all sensors, and the channel passes unchanged.
2. Only candidates with the most frequent model and order remain.
3. Of these, only candidates with the most frequent combination of modes, tones, coloured noise and gate remain.
4. Of these, the medoid is copied: the sensor with the smallest sum of distances to the others, in the logarithms of
   noise_std and process_noise_density.

The numbers of several sensors are not averaged. Only the limits are joined, because they must hold for all healthy
sensors (`limits`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from typing import NamedTuple

import numpy as np

from becalm.cleaning.recipes.recipe import Recipe
from becalm.fleet.tuning.limits import limits_of_class
from becalm.fleet.tuning.sensor_tuning import SensorTuning, TunedChannel

_LEAST = float(np.finfo(np.float64).tiny)  # replaces a density of 0, which has no logarithm


class ClassRecipe(NamedTuple):
    """The recipe of a class.

    Attributes
    ----------
    recipe : Recipe
        The recipe.
    sensors : dict of str to str
        For each channel, by name, the sensor that its recipe was copied from.
    """

    recipe: Recipe
    sensors: dict[str, str]


def make_class_recipe(found: Sequence[SensorTuning]) -> ClassRecipe | None:
    """Return the recipe of a class; None if no channel occurs in more than half of its sensors.

    Parameters
    ----------
    found : sequence of SensorTuning
        The sensors of the class that could be tuned, sorted by name.
    """
    chosen = [
        _typical_channel(channels) for channels in channels_by_key(found).values() if 2 * len(channels) > len(found)
    ]
    if not chosen:
        return None
    sensors = {channel.recipe.name: channel.sensor for channel in chosen}
    first = next(one.recipe for one in found if one.sensor == chosen[0].sensor)
    alone = set(sensors.values()) == {chosen[0].sensor}
    origin = first.tuned_on if alone else first.tuned_on.model_copy(update={"sha256": ""})
    channels = tuple(channel.recipe for channel in chosen)
    return ClassRecipe(first.model_copy(update={"tuned_on": origin, "channel": channels}), sensors)


def channels_by_key(found: Sequence[SensorTuning]) -> dict[tuple[str, str], list[TunedChannel]]:
    """Return the channels of several sensors by name and unit."""
    channels: dict[tuple[str, str], list[TunedChannel]] = {}
    for channel in (channel for one in found for channel in one.channels):
        channels.setdefault(channel.key, []).append(channel)
    return channels


def _typical_channel(channels: Sequence[TunedChannel]) -> TunedChannel:
    alike = alike_in(channels)
    chosen = alike[medoid([_place(channel) for channel in alike])]
    limits = limits_of_class(alike, channels)
    return chosen._replace(recipe=chosen.recipe.model_copy(update={"limits": limits}))


def alike_in(channels: Sequence[TunedChannel]) -> list[TunedChannel]:
    """Return the candidates for the typical channel: steps 1 to 3 of the module's docstring."""
    moving = [channel for channel in channels if channel.moves]
    left = [channel for channel in channels if channel.fits] or moving or list(channels)
    for trait in (_order, _components):
        left = _most_frequent(left, trait)
    return left


def _order(channel: TunedChannel) -> Hashable:
    return channel.recipe.model, channel.recipe.order


def _components(channel: TunedChannel) -> Hashable:
    recipe = channel.recipe
    modes = 0 if recipe.switching is None else len(recipe.switching.mode)
    removed = sum(tone.disturbance for tone in recipe.tone)
    return modes, len(recipe.tone), removed, recipe.coloured_noise is not None, recipe.gate is not None


def _most_frequent(channels: list[TunedChannel], trait: Callable[[TunedChannel], Hashable]) -> list[TunedChannel]:
    """Return the channels with the most frequent value of a trait; of equally frequent values, the first counts."""
    ((most, _),) = Counter(map(trait, channels)).most_common(1)
    return [channel for channel in channels if trait(channel) == most]


def _place(channel: TunedChannel) -> tuple[float, float]:
    motion = channel.recipe.motion
    if motion is None:
        return 0.0, 0.0
    return float(np.log(motion.noise_std)), float(np.log(max(motion.process_noise_density, _LEAST)))


def medoid(places: Sequence[tuple[float, float]]) -> int:
    """Return the index of the point with the smallest sum of distances to all others; of equal sums, the first."""
    points = np.array(places)
    far = [float(np.hypot(*(points - point).T).sum()) for point in points]
    return int(np.argmin(far))
