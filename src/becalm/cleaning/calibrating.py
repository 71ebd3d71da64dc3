"""What a sensor's sheet leaves uncertain, put into the recipe of its channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.recipe_parts import CalibrationRecipe


def calibrated(
    channels: Sequence[ChannelRecipe], uncertainties: Mapping[str, tuple[float, float]]
) -> tuple[ChannelRecipe, ...]:
    """Return the recipes of channels with what their sensors leave uncertain.

    Parameters
    ----------
    channels : sequence of ChannelRecipe
        As they were tuned.
    uncertainties : mapping of str to (float, float)
        Standard uncertainties (k = 1) by names of channels: of the sensitivity, as a share; of the zero, in unit.
    """
    return tuple(_calibrated(channel, *uncertainties.get(channel.name, (0.0, 0.0))) for channel in channels)


def _calibrated(channel: ChannelRecipe, relative_std: float, offset_std: float) -> ChannelRecipe:
    if not (relative_std or offset_std):
        return channel
    told = CalibrationRecipe(relative_std=relative_std, offset_std=offset_std)
    return channel.model_copy(update={"calibration": told})
