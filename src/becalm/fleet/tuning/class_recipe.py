"""Make the recipe of a class: copy each channel from its most typical sensor, so that it fits at least that one.

The rule. A class's recipe has the channels, by name and unit, that more than half of its tuned sensors have. The
candidates for a channel are the sensors whose own filter describes it; if there are none, those that have a filter; if
there are none either, all, and the channel passes unchanged. Only candidates with the most frequent order stay, and of
these only those with the most frequent combination of modes, tones, coloured noise and gate. The most typical one is
their medoid: the one with the least sum of distances to the others, in the logarithms of noise_std and
process_noise_density. Its numbers are not averaged with those of others. Only the limits are joined, because they have
to hold for all healthy sensors (`limits`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from typing import NamedTuple

import numpy as np

from becalm.cleaning.recipe import Recipe
from becalm.fleet.tuning.limits import limits_of_class
from becalm.fleet.tuning.sensor_tuning import SensorTuning, TunedChannel

_LEAST = float(np.finfo(np.float64).tiny)  # stands for a density of 0 in logarithms


class Typical(NamedTuple):
    """The recipe of a class.

    Attributes
    ----------
    recipe : Recipe
        The recipe.
    sensors : dict of str to str
        The sensor that each channel's recipe was copied from, by name of the channel.
    """

    recipe: Recipe
    sensors: dict[str, str]


def typical(found: Sequence[SensorTuning]) -> Typical | None:
    """Return the recipe of a class; None if no channel is common to more than half of its sensors.

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
    return Typical(first.model_copy(update={"tuned_on": origin, "channel": channels}), sensors)


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
    """Return the candidates for the typical channel: those that fit, if any do, and have the most frequent traits."""
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
    """Return the channels with the most frequent trait; in a tie, the trait of the first channel counts."""
    ((most, _),) = Counter(map(trait, channels)).most_common(1)
    return [channel for channel in channels if trait(channel) == most]


def _place(channel: TunedChannel) -> tuple[float, float]:
    motion = channel.recipe.motion
    if motion is None:
        return 0.0, 0.0
    return float(np.log(motion.noise_std)), float(np.log(max(motion.process_noise_density, _LEAST)))


def medoid(places: Sequence[tuple[float, float]]) -> int:
    """Return the index of the place with the least sum of distances to all others; in a tie, the first."""
    points = np.array(places)
    far = [float(np.hypot(*(points - point).T).sum()) for point in points]
    return int(np.argmin(far))
