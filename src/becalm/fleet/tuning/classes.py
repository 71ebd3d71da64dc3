"""Divide a lake into classes: choose which sensors of each class are tuned, and store the results."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from becalm.files.lake.listing import natural
from becalm.fleet.class_outliers import class_of
from becalm.fleet.lake import SensorPlace
from becalm.fleet.outcome import Outcome
from becalm.fleet.tuning.class_differences import Key, is_described, reasons, rows_by_key
from becalm.fleet.tuning.class_recipe import ClassRecipe, make_class_recipe
from becalm.fleet.tuning.sensor_tuning import SensorTuning, TunedChannel
from becalm.report.fleet.fleet_rows import FleetRow, counted, spaced

MOST_SENSORS = 200
"""Default number of sensors that are tuned in each class; with more sensors, the recipe does not improve."""

_NO_CLASS = "They are of several kinds and should be in separate folders, or no filter describes them."


class Chosen(NamedTuple):
    """The sensors of one class that are chosen for tuning."""

    name: str  # name of the class
    sensors: int  # number of the class's sensors in the lake
    places: tuple[SensorPlace, ...]  # the sensors to tune, by name


def chosen_of(places: Sequence[SensorPlace], most: int = MOST_SENSORS) -> list[Chosen]:
    """Return the classes of some sensors, sorted by name, with the sensors to tune in each.

    Parameters
    ----------
    places : sequence of SensorPlace
        The sensors of a lake.
    most : int
        Largest number of sensors to tune in each class. They are spread evenly over the sorted names, and include the
        first and the last.
    """
    classes: dict[str, list[SensorPlace]] = defaultdict(list)
    for place in sorted(places, key=lambda place: natural(Path(place.name))):
        classes[class_of(place.name)].append(place)
    return [Chosen(name, len(own), tuple(_spread(own, most))) for name, own in sorted(classes.items())]


def _spread(places: Sequence[SensorPlace], most: int) -> list[SensorPlace]:
    if len(places) <= most:
        return list(places)
    return [places[number] for number in np.linspace(0, len(places) - 1, most).round().astype(int).tolist()]


@dataclass(frozen=True)
class TunedClass:
    """The result of tuning a class.

    Attributes
    ----------
    name : str
        Name of the class and of its recipe.
    sensors : int
        Number of sensors of the class in the lake.
    found : tuple of SensorTuning
        The sensors that could be tuned, by name.
    failed : tuple of Outcome
        The sensors that could not be tuned, with the reasons.
    class_recipe : ClassRecipe or None
        The recipe of the class, or None if it has none.
    judged : mapping of str to Outcome
        The outcome of the class's recipe on each tuned sensor, by the sensor's name.
    """

    name: str
    sensors: int
    found: tuple[SensorTuning, ...]
    failed: tuple[Outcome, ...]
    class_recipe: ClassRecipe | None
    judged: Mapping[str, Outcome]

    @classmethod
    def of(cls, chosen: Chosen, outcomes: Mapping[str, SensorTuning | Outcome]) -> TunedClass:
        """Collect the results of the tuning tasks of a class, and make its recipe; `judged` is empty."""
        own = [outcomes[place.name] for place in chosen.places]
        found = tuple(one for one in own if isinstance(one, SensorTuning))
        failed = tuple(one for one in own if isinstance(one, Outcome))
        return cls(chosen.name, chosen.sensors, found, failed, make_class_recipe(found) if found else None, {})

    def with_judged(self, outcomes: Mapping[str, Outcome]) -> TunedClass:
        """Return the class with the outcomes of its recipe on its sensors."""
        return replace(self, judged={one.sensor: outcomes[one.sensor] for one in self.found if one.sensor in outcomes})

    @cached_property
    def differences(self) -> dict[Key, str]:
        """Return, by sensor and channel, a sentence on how each channel that differs from the class differs."""
        return reasons(self.found, self.class_recipe, self.judged)

    def row_of(self, channel: TunedChannel, *, own: bool) -> FleetRow:
        """Return a channel's row of the report, as its own recipe or the class's recipe gives it.

        With `own` false, the row is that of the class's recipe, with the noise of the channel's own recipe if both
        have the same unit. The row of the channel's own recipe is also returned if the channel passes unchanged, if the
        class's recipe lacks the channel, or if the sensor was refused with the class's recipe.
        """
        row = self._rows.get((channel.sensor, channel.recipe.name))
        if own or not channel.moves or row is None:
            return channel.row
        return replace(row, noise_std=channel.row.noise_std) if row.unit == channel.row.unit else row

    @cached_property
    def _rows(self) -> dict[Key, FleetRow]:
        return rows_by_key(self.judged)

    @property
    def described(self) -> tuple[int, int]:
        """Return how many channels the class's recipe describes, and how many it was run on."""
        channels = [channel for one in self.found for channel in one.channels if channel.moves]
        rows = [self._rows.get((channel.sensor, channel.recipe.name)) for channel in channels]
        filtered = [row for row in rows if row is not None]
        return sum(map(is_described, filtered)), len(filtered)

    @property
    def says(self) -> str:
        """Return a summary of one or two sentences."""
        tried = len(self.found) + len(self.failed)
        over = "" if tried == self.sensors else f", spread evenly by name over all {spaced(self.sensors)}"
        summary = f"{self.name}: {spaced(len(self.found))} of {counted(tried, 'sensor', 'sensors')} tuned{over}."
        if not self.found:
            return f"{summary} It has no recipe: none could be tuned."
        if self.class_recipe is None:
            return f"{summary} It has no recipe: more than half of them have no channel in common."
        described, channels = self.described
        summary += f" Its recipe describes {spaced(described)} of {counted(channels, 'channel', 'channels')}."
        return summary if 2 * described > channels else f"{summary} {_NO_CLASS}"
