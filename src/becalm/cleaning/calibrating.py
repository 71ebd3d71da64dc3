"""What a sensor's sheet leaves uncertain, and the zero that was taken, put into the recipe of its channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.recipe_parts import CalibrationRecipe, TareRecipe
from becalm.sensors.record import Calibration


def calibrated(channels: Sequence[ChannelRecipe], calibrations: Mapping[str, Calibration]) -> tuple[ChannelRecipe, ...]:
    """Return the recipes of channels with the calibrations of their sensors, by names of channels."""
    return tuple(_calibrated(channel, calibrations.get(channel.name)) for channel in channels)


def tared_anew(channels: Sequence[ChannelRecipe], calibrations: Mapping[str, Calibration]) -> tuple[ChannelRecipe, ...]:
    """Return the recipes of channels with the zeros that were taken this time, which another recording has others."""
    tares = {name: one for name, one in calibrations.items() if one.tare is not None}
    return calibrated(channels, tares)


def _calibrated(channel: ChannelRecipe, found: Calibration | None) -> ChannelRecipe:
    if found is None or not (found.relative_std or found.offset_std or found.tare):
        return channel
    tare = None if found.tare is None else TareRecipe(**found.tare._asdict())
    told = CalibrationRecipe(relative_std=found.relative_std, offset_std=found.offset_std, tare=tare)
    return channel.model_copy(update={"calibration": told})
