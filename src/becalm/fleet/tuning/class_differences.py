"""Describe in words how a sensor differs from its class.

A channel differs from its class if its noise is an outlier (`fleet.class_outliers`), or if the class's recipe does not
describe the channel, but describes most others. A recipe describes a channel if the verdict is "fits" or "fits except",
and the mean NIS is within a factor of two of 1. A different order or process noise alone is not a reason, because the
class's recipe may still describe the channel; such a difference is mentioned only together with a reason.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.fleet.class_outliers import FACTOR, factors_apart, times
from becalm.fleet.outcome import Outcome
from becalm.fleet.tuning.class_recipe import ClassRecipe, channels_by_key
from becalm.fleet.tuning.sensor_tuning import SensorTuning, TunedChannel
from becalm.report.fleet.fleet_order import DOUBTFUL
from becalm.report.fleet.fleet_rows import FleetRow

_STRONGER = 3.0  # smallest ratio of process noise densities that is mentioned; estimates of a density scatter

Key = tuple[str, str]  # name of a sensor, and of one of its channels


def is_described(row: FleetRow) -> bool:
    """Return whether a recipe describes a channel, and its sigma is right to within a factor of sqrt(2)."""
    return row.verdict in ("fits", "fits except") and 1 / DOUBTFUL <= (row.health or 0.0) <= DOUBTFUL


def reasons(
    found: Sequence[SensorTuning], class_recipe: ClassRecipe | None, judged: Mapping[str, Outcome]
) -> dict[Key, str]:
    """Return, by sensor and channel, a sentence on how each channel that differs from its class differs.

    Parameters
    ----------
    found : sequence of SensorTuning
        The sensors of the class that could be tuned.
    class_recipe : ClassRecipe or None
        The recipe of the class; None if it has none.
    judged : mapping of str to Outcome
        The outcome of the class's recipe on each sensor, by the sensor's name.
    """
    if class_recipe is None:
        why = "Its class has no recipe: more than half of its sensors have no channel in common."
        return {(channel.sensor, channel.recipe.name): why for one in found for channel in one.channels}
    # Channels are matched by name only, so that a channel in another unit is compared too.
    decided = {one.name: one for one in class_recipe.recipe.channel}
    rows = rows_by_key(judged)
    whys: dict[Key, str] = {}
    for (name, _), channels in channels_by_key(found).items():
        whys |= _of_channel(channels, decided[name], rows) if name in decided else _rare(channels)
    for sensor, outcome in judged.items():
        if outcome.state == "refused":
            whys |= _not_run(next(one for one in found if one.sensor == sensor), outcome.reason)
    return whys


def rows_by_key(judged: Mapping[str, Outcome]) -> dict[Key, FleetRow]:
    """Return the rows of the report, by sensor and channel, of all sensors that were not refused."""
    run = [outcome for outcome in judged.values() if outcome.state != "refused"]
    return {(row.sensor, row.channel): row for outcome in run for row in outcome.channels}


def _rare(channels: Sequence[TunedChannel]) -> dict[Key, str]:
    why = "Few sensors of its class have this channel, so the recipe of its class passes it unchanged."
    return {(channel.sensor, channel.recipe.name): why for channel in channels}


def _not_run(one: SensorTuning, reason: str) -> dict[Key, str]:
    why = f"Its class's recipe does not run on it: {reason}"
    return {(channel.sensor, channel.recipe.name): why for channel in one.channels}


def _of_channel(
    channels: Sequence[TunedChannel], decided: ChannelRecipe, rows: Mapping[Key, FleetRow]
) -> dict[Key, str]:
    """Return, for one channel, the reason for each sensor that differs from its class."""
    moving = [channel for channel in channels if channel.moves]
    factors = factors_apart([channel.recipe.noise_std or 0.0 for channel in moving])
    judged = [rows.get((channel.sensor, channel.recipe.name)) for channel in moving]
    described = [is_described(row) for row in judged if row is not None]
    usable = 2 * sum(described) > len(described)  # otherwise the recipe is at fault
    whys = {}
    for channel, factor, row in zip(moving, factors, judged, strict=True):
        parts = [] if factor is None else [f"its noise is {times(factor)} that of its class"]
        if usable and row is not None and not is_described(row):
            parts.append(_not_described(channel, decided, row, with_noise=factor is None))
        if parts:
            whys[channel.sensor, channel.recipe.name] = _sentence(parts)
    return whys


def _not_described(channel: TunedChannel, decided: ChannelRecipe, row: FleetRow, *, with_noise: bool) -> str:
    """Return a clause: the class's recipe does not describe a channel, whose own recipe differs in these details."""
    nis = [] if row.health is None else [f"NIS {row.health:.2g}"]
    own = [] if channel.fits else ["its own does not either"]
    details = ", ".join([*nis, *_differing(channel.recipe, decided, with_noise=with_noise), *own])
    return "its class's recipe does not describe it" + (f" ({details})" if details else "")


def _differing(own: ChannelRecipe, decided: ChannelRecipe, *, with_noise: bool) -> list[str]:
    """Return phrases on how a channel's own recipe differs from the recipe of its class."""
    if own.unit != decided.unit:
        return []
    if own.order != decided.order:
        return [f"order {own.order} where its class has {decided.order or decided.model}"]
    noise = [("noise_std", own.noise_std, decided.noise_std, FACTOR)] if with_noise else []
    density = ("process_noise_density", own.process_noise_density, decided.process_noise_density, _STRONGER)
    return [
        f"its {name} is {times(one / other)} the recipe's"
        for name, one, other, least in (*noise, density)
        if one and other and not 1 / least <= one / other <= least
    ]


def _sentence(parts: Sequence[str]) -> str:
    text = "; ".join(parts)
    return f"{text[0].upper()}{text[1:]}."
