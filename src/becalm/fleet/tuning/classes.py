"""The classes of a lake: which sensors of each are tuned, and what came of it."""

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
from becalm.fleet.tuning.class_recipe import Typical, typical
from becalm.fleet.tuning.found import SensorTuning, TunedChannel
from becalm.report.fleet_rows import FleetRow, counted, spaced

MOST_SENSORS = 200
"""Of each class, that are tuned where nothing else is said: more make no class better known."""

_NO_CLASS = "They are of several kinds, which folders of their own would tell apart, or no filter describes them."


class Chosen(NamedTuple):
    """The sensors of a class."""

    name: str
    sensors: int  # of it in the lake
    places: tuple[SensorPlace, ...]  # of those to be tuned, by name


def chosen_of(places: Sequence[SensorPlace], most: int = MOST_SENSORS) -> list[Chosen]:
    """Return the classes of some sensors by name, with those of each that are to be tuned.

    Parameters
    ----------
    places : sequence of SensorPlace
        The sensors of a lake.
    most : int
        How many of each class; they are spread evenly over the order of their names, the first and the last among them.
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
    """What tuning found for a class.

    Attributes
    ----------
    name : str
        Of its recipe as well.
    sensors : int
        How many the lake has.
    found : tuple of SensorTuning
        Those that could be tuned, by name.
    failed : tuple of Outcome
        Those that could not, with their reasons.
    typical : Typical or None
        Its recipe; None where it has none.
    judged : mapping of str to Outcome
        By sensors that could be tuned, what its recipe makes of them.
    """

    name: str
    sensors: int
    found: tuple[SensorTuning, ...]
    failed: tuple[Outcome, ...]
    typical: Typical | None
    judged: Mapping[str, Outcome]

    @classmethod
    def of(cls, chosen: Chosen, told: Mapping[str, SensorTuning | Outcome]) -> TunedClass:
        """Put together what tasks told of a class; nothing is judged yet."""
        own = [told[place.name] for place in chosen.places]
        found = tuple(one for one in own if isinstance(one, SensorTuning))
        failed = tuple(one for one in own if isinstance(one, Outcome))
        return cls(chosen.name, chosen.sensors, found, failed, typical(found) if found else None, {})

    def with_judged(self, told: Mapping[str, Outcome]) -> TunedClass:
        """Return it with what its recipe makes of its sensors."""
        return replace(self, judged={one.sensor: told[one.sensor] for one in self.found if one.sensor in told})

    @cached_property
    def unlike(self) -> dict[Key, str]:
        """Why sensors are unlike it, by sensors and channels."""
        return reasons(self.found, self.typical, self.judged)

    def row_of(self, channel: TunedChannel, *, own: bool) -> FleetRow:
        """Return what is told of a channel: what its own recipe, or that of its class, makes of it.

        The noise is that which was found on the sensor itself, unless it was in another unit. A constant channel, one
        that the class's recipe leaves out, or that of a sensor it does not run on, has what its own recipe says.
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
        """How many channels of its sensors its recipe describes, and of how many that are filtered."""
        channels = [channel for one in self.found for channel in one.channels if channel.moves]
        rows = [self._rows.get((channel.sensor, channel.recipe.name)) for channel in channels]
        known = [row for row in rows if row is not None]
        return sum(map(is_described, known)), len(known)

    @property
    def says(self) -> str:
        """How it went, in a sentence or two."""
        tried = len(self.found) + len(self.failed)
        over = "" if tried == self.sensors else f", spread evenly by name over all {spaced(self.sensors)}"
        told = f"{self.name}: {spaced(len(self.found))} of {counted(tried, 'sensor', 'sensors')} tuned{over}."
        if not self.found:
            return f"{told} It has no recipe: none could be tuned."
        if self.typical is None:
            return f"{told} It has no recipe: more than half of them have no channel in common."
        described, channels = self.described
        told += f" Its recipe describes {spaced(described)} of {counted(channels, 'channel', 'channels')}."
        return told if 2 * described > channels else f"{told} {_NO_CLASS}"
