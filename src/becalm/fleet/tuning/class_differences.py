"""Describe in words how a sensor differs from its class.

A channel is unlike that of its class where its noise is (`fleet.class_outliers`), or where the class's recipe does not
describe it while it describes most others: by the judge's verdict, or because the mean NIS is not within a factor of
two of 1. An order, or a process noise, of its own is no reason but is told with one: where the class's recipe does as
well, it makes no difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from becalm.cleaning.recipe import ChannelRecipe
from becalm.fleet.class_outliers import FACTOR, factors_apart, times
from becalm.fleet.outcome import Outcome
from becalm.fleet.tuning.class_recipe import Typical, channels_by_key
from becalm.fleet.tuning.found import SensorTuning, TunedChannel
from becalm.report.fleet_order import DOUBTFUL
from becalm.report.fleet_rows import FleetRow

_STRONGER = 3.0  # by which process noise densities differ at least, to be told of: they scatter by themselves

Key = tuple[str, str]  # a sensor, and a channel of it


def is_described(row: FleetRow) -> bool:
    """Whether a recipe describes a channel, and its sigma is right to a factor of the root of two."""
    return row.verdict in ("fits", "fits except") and 1 / DOUBTFUL <= (row.health or 0.0) <= DOUBTFUL


def reasons(
    found: Sequence[SensorTuning], class_recipe: Typical | None, judged: Mapping[str, Outcome]
) -> dict[Key, str]:
    """Say of sensors and channels that are unlike their class why, as sentences.

    Parameters
    ----------
    found : sequence of SensorTuning
        The sensors of the class that could be tuned.
    class_recipe : Typical or None
        The recipe of the class.
    judged : mapping of str to Outcome
        By sensors, what that makes of them.
    """
    if class_recipe is None:
        why = "Its class has no recipe: more than half of its sensors have no channel in common."
        return {(channel.sensor, channel.recipe.name): why for one in found for channel in one.channels}
    decided = {one.name: one for one in class_recipe.recipe.channel}  # in another unit it is converted
    rows = rows_by_key(judged)
    told: dict[Key, str] = {}
    for (name, _), channels in channels_by_key(found).items():
        told |= _of_channel(channels, decided[name], rows) if name in decided else _rare(channels)
    for sensor, outcome in judged.items():
        if outcome.state == "refused":
            told |= _not_run(next(one for one in found if one.sensor == sensor), outcome.reason)
    return told


def rows_by_key(judged: Mapping[str, Outcome]) -> dict[Key, FleetRow]:
    """Return what a recipe makes of channels, by sensors and channels, where it runs on them."""
    run = [outcome for outcome in judged.values() if outcome.state != "refused"]
    return {(row.sensor, row.channel): row for outcome in run for row in outcome.channels}


def _rare(channels: Sequence[TunedChannel]) -> dict[Key, str]:
    why = "Few sensors of its class have this channel, so that its class's recipe passes it unchanged."
    return {(channel.sensor, channel.recipe.name): why for channel in channels}


def _not_run(one: SensorTuning, reason: str) -> dict[Key, str]:
    why = f"Its class's recipe does not run on it: {reason}"
    return {(channel.sensor, channel.recipe.name): why for channel in one.channels}


def _of_channel(
    channels: Sequence[TunedChannel], decided: ChannelRecipe, rows: Mapping[Key, FleetRow]
) -> dict[Key, str]:
    """Say of sensors why a channel of theirs is unlike that of their class."""
    moving = [channel for channel in channels if channel.moves]
    factors = factors_apart([channel.recipe.noise_std or 0.0 for channel in moving])
    judged = [rows.get((channel.sensor, channel.recipe.name)) for channel in moving]
    described = [is_described(row) for row in judged if row is not None]
    telling = 2 * sum(described) > len(described)  # a recipe that describes few tells of the class, not of them
    told = {}
    for channel, factor, row in zip(moving, factors, judged, strict=True):
        parts = [] if factor is None else [f"its noise is {times(factor)} that of its class"]
        if telling and row is not None and not is_described(row):
            parts.append(_not_described(channel, decided, row, noise_told=factor is not None))
        if parts:
            told[channel.sensor, channel.recipe.name] = _sentence(parts)
    return told


def _not_described(channel: TunedChannel, decided: ChannelRecipe, row: FleetRow, *, noise_told: bool) -> str:
    """Say that the recipe of its class does not describe a channel, and how its own differs."""
    nis = [] if row.health is None else [f"NIS {row.health:.2g}"]
    own = [] if channel.fits else ["its own does not either"]
    details = ", ".join([*nis, *_differing(channel.recipe, decided, noise_told=noise_told), *own])
    return "its class's recipe does not describe it" + (f" ({details})" if details else "")


def _differing(own: ChannelRecipe, decided: ChannelRecipe, *, noise_told: bool) -> list[str]:
    """Say how the recipe of a sensor differs from that of its class."""
    if own.unit != decided.unit:
        return []
    if own.order != decided.order:
        return [f"order {own.order} where its class has {decided.order or decided.model}"]
    noise = [] if noise_told else [("noise_std", own.noise_std, decided.noise_std, FACTOR)]
    density = ("process_noise_density", own.process_noise_density, decided.process_noise_density, _STRONGER)
    return [
        f"its {name} is {times(one / other)} the recipe's"
        for name, one, other, least in (*noise, density)
        if one and other and not 1 / least <= one / other <= least
    ]


def _sentence(parts: Sequence[str]) -> str:
    told = "; ".join(parts)
    return f"{told[0].upper()}{told[1:]}."
