"""What a person says of a stream over a fleet."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from math import inf
from typing import Protocol

from becalm.cleaning.recipe import Recipe
from becalm.errors import UsageError
from becalm.live.address import Address
from becalm.live.learning import FEW_STAMPS

FIRST_ROWS = FEW_STAMPS
"""So many rows of a sensor are waited for before the first is told: they tell the last digit of its stamps."""

START, MOST = "start", "most"
"""Options of brokers: where a new stream begins, and how many messages a micro-batch takes at most."""
_MESSAGES = 100_000  # in a micro-batch, where nobody says


def most_of(address: Address) -> int:
    """Return how many messages a micro-batch takes at most."""
    return int(address.number(MOST, _MESSAGES, least=1))


class Book(Protocol):
    """Tells the recipe of each sensor. It can be pickled; workers ask it anew in every micro-batch."""

    def recipe_for(self, sensor: str) -> Recipe:
        """Return what is to be done with a sensor, now.

        Raises
        ------
        BecalmError
            If there is none, or none that can be read.
        """
        ...

    def channels(self) -> tuple[str, ...]:
        """Return the channels of all recipes, now.

        Raises
        ------
        BecalmError
            If there is no recipe, or one cannot be read.
        """
        ...


@dataclass(frozen=True)
class SensorPlan:
    """What is done with the rows of each sensor.

    Attributes
    ----------
    recipes : Book
        Which recipe each sensor has. It may change while the stream runs: another recipe takes over without a jump.
    key : str
        The column that tells whose a row is.
    time : str
        The column of stamps: timestamps, or seconds. In files of a lake numbers may count what their column's name or
        unit says, or, where they look like it, milliseconds since 1970 and so on.
    channels : tuple of str
        Those of all sensors, a column each of what is told; () for those of all recipes when the stream is begun.
    lateness_s : float
        How long a row waits for rows that are stamped before it and come in a later micro-batch, by the stamps
        themselves; with a *small* one rows are told soon, and more that are late are left out. 0 puts in order
        only what comes in one micro-batch. Messages keep the order of their broker, and rows whose stamps count from
        a start of their own wait for none.
    silent_s : float or None
        After which time without a row a sensor is said to be silent, by the clock of the engine; None says nothing.
    messages : Address or None
        Says that rows come as messages, as `becalm live` reads them, and holds the options of their columns.
    """

    recipes: Book
    key: str = "sensor"
    time: str = "time"
    channels: tuple[str, ...] = ()
    lateness_s: float = 0.0
    silent_s: float | None = None
    messages: Address | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        if not 0.0 <= self.lateness_s < inf:
            raise UsageError(
                f"lateness_s = {self.lateness_s!r} (--lateness) is no time to wait; give seconds, 0 or more."
            )
        if self.silent_s is not None and not 0.0 < self.silent_s < inf:
            raise UsageError(
                f"silent_s = {self.silent_s!r} (--silent) is no time without a row; give seconds, or None."
            )

    def with_channels(self) -> SensorPlan:
        """Return the plan with its channels, those of all recipes where it names none.

        Raises
        ------
        BecalmError
            If there is no recipe, or one cannot be read.
        """
        return self if self.channels else replace(self, channels=self.recipes.channels())


@dataclass(frozen=True)
class StreamPlan:
    """A stream from a source through every sensor's filters into a folder.

    Attributes
    ----------
    source : str
        A folder of Parquet files that all workers see, `kafka://HOST:PORT/TOPIC`, or `nats://HOST:PORT/STREAM`.
    output : str
        The folder of what is told: OUTPUT/kind=readings/SENSOR_COLUMN=NAME/*.parquet, and what befell the stream in
        OUTPUT/kind=events. Its log, `_spark_metadata`, says which files count; read it as a whole by Spark, or a
        sensor's folder by `becalm.read`.
    sensors : SensorPlan
        What is done with the rows of each.
    checkpoint : str
        The folder where Spark keeps positions and filters; "" for OUTPUT/_checkpoint. It belongs to this stream alone.
    every_s : float
        How often a micro-batch is begun, in seconds; with a *small* one rows are told soon, in many small files: one
        for each sensor, each time.
    partitions : int
        In how many tasks the sensors are filtered. It cannot be changed once a stream has begun.
    once : bool
        Whether to end with what is there now.
    """

    source: str
    output: str
    sensors: SensorPlan
    checkpoint: str = ""
    every_s: float = 60.0
    partitions: int = 16
    once: bool = False

    def __post_init__(self) -> None:
        """Refuse what cannot be; say of folders where they are, whoever looks for them from elsewhere."""
        for name in ("source", "output", "checkpoint"):
            place = getattr(self, name)
            if place and "://" not in place:
                object.__setattr__(self, name, os.path.abspath(place))  # noqa: PTH100  (also without `..`)
        if not 0.0 <= self.every_s < inf:
            raise UsageError(
                f"every_s = {self.every_s!r} (--every) is no time between micro-batches; give seconds, 0 or more."
            )
        if self.sensors.silent_s is not None and not self.every_s:
            raise UsageError(
                "every_s = 0 (--every) would look for silent sensors without a pause; give seconds, as 10."
            )
        if self.partitions < 1:
            raise UsageError(f"partitions = {self.partitions} are no tasks; give 1 or more.")

    @property
    def checkpoint_folder(self) -> str:
        """Where Spark keeps positions and filters."""
        return self.checkpoint or f"{self.output.rstrip('/')}/_checkpoint"
