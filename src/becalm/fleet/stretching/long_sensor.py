"""Describe a sensor that is cut in time; the tasks of its stretches receive this description."""

from __future__ import annotations

from typing import NamedTuple

from becalm.files.inputs.shared_source import ParsedSource
from becalm.fleet.job import Job, Sensor
from becalm.fleet.pieces import OutputFile

State = tuple[bytes, ...]
"""Packed states of the filters, one for each channel."""


class Extremes(NamedTuple):
    """The range of all readings before a row."""

    row: int  # index of this row
    least: tuple[float, ...]  # minimum of each channel
    most: tuple[float, ...]  # maximum of each channel


class LongSensor(NamedTuple):
    """A sensor that is cut in time."""

    job: Job
    sensor: Sensor
    recipe: str  # the text of the recipe, fitted to the sensor's channels
    causal: bool  # whether estimates use only the past
    parsed_source: ParsedSource  # the channels, the clock and the number of rows
    files: tuple[OutputFile, ...]  # the output files, one for each input file, in order
    staged: str  # path of the staging folder for the output
    hashed: str  # the hash of the input
    cuts: tuple[int, ...]  # the first row of each stretch, and the number of rows
    first: tuple[float, ...]  # the first usable reading of each channel; NaN if there is none
    extremes: tuple[Extremes, ...]  # in the order of rows; () if the files have no statistics
    notes: tuple[str, ...]  # sentences about the files and the clock, for the report
    took_s: float  # the duration of the survey, in seconds


class TaskStretch(NamedTuple):
    """Successive rows of one sensor, which a task cleans."""

    number: int  # index among the stretches of the sensor
    first: int  # first row
    stop: int  # row after the last
    state: State | None = None  # the filters' state before the first row; None to find it by a warm-up
