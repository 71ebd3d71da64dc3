"""Define the options of a stream over a fleet."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from math import inf
from typing import Protocol

from becalm.cleaning.recipes.recipe import Recipe
from becalm.errors import UsageError
from becalm.live.address import Address
from becalm.live.running.learning_buffer import FEW_STAMPS

FIRST_ROWS = FEW_STAMPS
"""Rows of a sensor that must arrive before its first estimate, because they show the resolution of its stamps."""

START, MOST = "start", "most"
"""Options of a broker's address: where a new stream starts, and the largest number of messages in a micro-batch."""

_MESSAGES = 100_000  # default of the option `MOST`


def most_of(address: Address) -> int:
    """Return the largest number of messages in a micro-batch, from an address.

    Raises
    ------
    UsageError
        If the value in the address is not a number of 1 or more.
    """
    return int(address.number(MOST, _MESSAGES, least=1))


class Book(Protocol):
    """A source of each sensor's recipe. It must be picklable; workers call it in every micro-batch."""

    def recipe_for(self, sensor: str) -> Recipe:
        """Return the current recipe of a sensor.

        Raises
        ------
        BecalmError
            If there is no recipe, or it cannot be read.
        """
        ...

    def channels(self) -> tuple[str, ...]:
        """Return the channels of all current recipes.

        Raises
        ------
        BecalmError
            If there is no recipe, or a recipe cannot be read.
        """
        ...


@dataclass(frozen=True)
class SensorPlan:
    """The options of a stream that concern each sensor.

    Attributes
    ----------
    recipes : Book
        The recipe of each sensor. A recipe may change while the stream runs, without a jump in the estimates.
    key : str
        The column that names the sensor of a row.
    time : str
        The column of stamps: timestamps, or numbers in seconds. In files of a lake, numbers may have another unit,
        which the column's name or metadata states, or which their size suggests, such as milliseconds since 1970.
    channels : tuple of str
        The channels of all sensors; each channel has columns in the output. With (), they are the channels of all
        recipes that exist when the stream starts.
    lateness_s : float
        How long a row waits for rows with earlier stamps that arrive in a later micro-batch, in seconds of the stamps.
        With a *small* value estimates come sooner, but more late rows are left out. With 0, rows are sorted only within
        a micro-batch. Messages keep the order of their broker. Rows never wait if their stamps do not count from 1970.
    silent_s : float or None
        Seconds without a row, by Spark's clock, after which a sensor is reported as silent; None for no such reports.
    messages : Address or None
        The address of the source, if its rows are messages, with the options of their columns as in `becalm live`; None
        for rows of files.
    """

    recipes: Book
    key: str = "sensor"
    time: str = "time"
    channels: tuple[str, ...] = ()
    lateness_s: float = 0.0
    silent_s: float | None = None
    messages: Address | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        if not 0.0 <= self.lateness_s < inf:
            raise UsageError(
                f"lateness_s = {self.lateness_s!r} (--lateness) is not a valid time to wait; give seconds, 0 or more."
            )
        if self.silent_s is not None and not 0.0 < self.silent_s < inf:
            raise UsageError(
                f"silent_s = {self.silent_s!r} (--silent) is not a valid time without rows; give seconds above 0, or"
                " None."
            )

    def with_channels(self) -> SensorPlan:
        """Return the plan with channels: its own, or if it names none, those of all recipes.

        Raises
        ------
        BecalmError
            If there is no recipe, or a recipe cannot be read.
        """
        return self if self.channels else replace(self, channels=self.recipes.channels())


@dataclass(frozen=True)
class StreamPlan:
    """The options of a stream that filters every sensor of a source and writes into a folder.

    Attributes
    ----------
    source : str
        A folder of Parquet files that all workers see, `kafka://HOST:PORT/TOPIC`, or `nats://HOST:PORT/STREAM`.
    output : str
        The output folder. Estimates are in OUTPUT/kind=readings/SENSOR_COLUMN=NAME/*.parquet, events in
        OUTPUT/kind=events. Spark's log in it, `_spark_metadata`, lists the valid files; read the whole folder with
        Spark, or the folder of one sensor with `becalm.read`.
    sensors : SensorPlan
        The options of each sensor.
    checkpoint : str
        The folder where Spark stores positions and filter states; "" for OUTPUT/_checkpoint. No other stream may use
        this folder.
    every_s : float
        Seconds between the starts of micro-batches. With a *small* value estimates come sooner, but in many small
        files: one file for each sensor and micro-batch.
    partitions : int
        Number of tasks that filter the sensors. This number cannot change after the first start of a stream.
    once : bool
        Whether to stop after all data that exist at the start.
    """

    source: str
    output: str
    sensors: SensorPlan
    checkpoint: str = ""
    every_s: float = 60.0
    partitions: int = 16
    once: bool = False

    def __post_init__(self) -> None:
        """Check the values, and make the paths of folders absolute, because workers have other current folders."""
        for name in ("source", "output", "checkpoint"):
            place = getattr(self, name)
            if place and "://" not in place:
                object.__setattr__(self, name, os.path.abspath(place))  # noqa: PTH100  (also without `..`)
        if not 0.0 <= self.every_s < inf:
            raise UsageError(
                f"every_s = {self.every_s!r} (--every) is not a valid time between micro-batches; give seconds, 0 or"
                " more."
            )
        if self.sensors.silent_s is not None and not self.every_s:
            raise UsageError(
                "every_s = 0 (--every) would look for silent sensors without a pause; give seconds, such as 10."
            )
        if self.partitions < 1:
            raise UsageError(f"partitions = {self.partitions} is not a number of tasks; give 1 or more.")

    @property
    def checkpoint_folder(self) -> str:
        """Return the folder where Spark stores positions and filter states."""
        return self.checkpoint or f"{self.output.rstrip('/')}/_checkpoint"
