"""Describe a sensor that is cut in time; the tasks of all its stretches receive this description."""

from __future__ import annotations

from typing import NamedTuple

from becalm.files.shared_source import ParsedSource
from becalm.fleet.job import Job, Sensor
from becalm.fleet.pieces import OutputFile

State = tuple[bytes, ...]
"""Packed states of the filters, one for each channel."""


class Extremes(NamedTuple):
    """The range of all readings before a row."""

    row: int  # its index
    least: tuple[float, ...]  # one for each channel
    most: tuple[float, ...]


class LongSensor(NamedTuple):
    """A sensor that is cut in time."""

    job: Job
    sensor: Sensor
    recipe: str  # the text of its recipe, fitted to its channels
    causal: bool  # whether estimates use only the past
    known: ParsedSource  # its channels, clock and number of rows
    files: tuple[OutputFile, ...]  # the output files, one for each input file, in order
    staged: str  # the staging folder of its output
    hashed: str  # the hash of its input
    cuts: tuple[int, ...]  # the first row of each stretch, and the number of rows
    first: tuple[float, ...]  # the first usable reading of each channel
    extremes: tuple[Extremes, ...]  # in the order of rows; () if the files do not have them
    notes: tuple[str, ...]  # sentences about its files and clock
    took_s: float  # the time of the survey, in seconds


class TaskStretch(NamedTuple):
    """Successive rows of one sensor, which a task cleans."""

    number: int  # index among the stretches of the sensor
    first: int  # first row
    stop: int  # row after the last
    state: State | None = None  # the filters' state after the rows before it, if that is known
