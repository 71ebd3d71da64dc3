"""Define the result of tuning one sensor, which its task returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from becalm.cleaning.recipes.recipe import ChannelRecipe, Recipe
from becalm.report.fleet.fleet_rows import FleetRow


class TunedChannel(NamedTuple):
    """A tuned channel of a sensor.

    Attributes
    ----------
    sensor : str
        The sensor's path within the lake.
    recipe : ChannelRecipe
        The tuned recipe of the channel.
    row : FleetRow
        The result of this recipe on the rows that it was tuned on.
    lowest, highest : float
        The range of the channel's valid readings, in its unit; NaN if there are none.
    """

    sensor: str
    recipe: ChannelRecipe
    row: FleetRow
    lowest: float
    highest: float

    @property
    def key(self) -> tuple[str, str]:
        """Return the channel's name and unit; two sensors have the same channel if both are equal."""
        return self.recipe.name, self.recipe.unit

    @property
    def moves(self) -> bool:
        """Return whether the channel is filtered; constant and nearly empty channels are not."""
        return self.recipe.motion is not None

    @property
    def fits(self) -> bool:
        """Return whether the filter describes the rows that it was tuned on."""
        return self.moves and self.row.verdict in ("fits", "fits except")


@dataclass(frozen=True)
class SensorTuning:
    """The result of tuning a sensor.

    Attributes
    ----------
    sensor : str
        The sensor's path within the lake.
    recipe : Recipe
        The tuned recipe; `becalm tune` makes the same one.
    channels : tuple of TunedChannel
        The channels, in the order of the recipe.
    took_s : float
        Time that tuning took, in seconds.
    """

    sensor: str
    recipe: Recipe
    channels: tuple[TunedChannel, ...]
    took_s: float = 0.0
