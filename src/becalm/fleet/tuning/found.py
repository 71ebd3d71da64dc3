"""What tuning found on one sensor, as its task tells it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from becalm.cleaning.recipe import ChannelRecipe, Recipe
from becalm.report.fleet_rows import FleetRow


class TunedChannel(NamedTuple):
    """A channel of a sensor.

    Attributes
    ----------
    sensor : str
        Its path within the lake.
    recipe : ChannelRecipe
        What was decided.
    row : FleetRow
        What that makes of the rows it was tuned on.
    lowest, highest : float
        Between which its readings lie, in unit; NaN where it has none.
    """

    sensor: str
    recipe: ChannelRecipe
    row: FleetRow
    lowest: float
    highest: float

    @property
    def key(self) -> tuple[str, str]:
        """What tells whether two sensors have the same channel: its name and unit."""
        return self.recipe.name, self.recipe.unit

    @property
    def moves(self) -> bool:
        """Whether there is a filter: a constant or nearly empty channel tells of none."""
        return self.recipe.motion is not None

    @property
    def fits(self) -> bool:
        """Whether the filter describes what it was tuned on."""
        return self.moves and self.row.verdict in ("fits", "fits except")


@dataclass(frozen=True)
class SensorTuning:
    """A sensor that could be tuned.

    Attributes
    ----------
    sensor : str
        Its path within the lake.
    recipe : Recipe
        That `becalm tune` would make of it.
    channels : tuple of TunedChannel
        Those of the recipe, in their order.
    took_s : float
        How long it took, in seconds.
    """

    sensor: str
    recipe: Recipe
    channels: tuple[TunedChannel, ...]
    took_s: float = 0.0
