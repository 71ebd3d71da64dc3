"""Add the calibration uncertainty and the tare of sensors to the recipes of their channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.recipe_parts import CalibrationRecipe, TareRecipe

if TYPE_CHECKING:
    from becalm.sensors.record import Calibration


def calibrated(channels: Sequence[ChannelRecipe], calibrations: Mapping[str, Calibration]) -> tuple[ChannelRecipe, ...]:
    """Return the recipes with the calibrations of their sensors; `calibrations` are by channel name."""
    return tuple(_calibrated(channel, calibrations.get(channel.name)) for channel in channels)


def with_new_tares(
    channels: Sequence[ChannelRecipe], calibrations: Mapping[str, Calibration]
) -> tuple[ChannelRecipe, ...]:
    """Return the recipes with the tares of the present recording, in place of those of the tuning recording."""
    tares = {name: one for name, one in calibrations.items() if one.tare is not None}
    return calibrated(channels, tares)


def _calibrated(channel: ChannelRecipe, found: Calibration | None) -> ChannelRecipe:
    if found is None or not (found.relative_std or found.offset_std or found.tare):
        return channel
    tare = None if found.tare is None else TareRecipe(**found.tare._asdict())
    calibration = CalibrationRecipe(relative_std=found.relative_std, offset_std=found.offset_std, tare=tare)
    return channel.model_copy(update={"calibration": calibration})
