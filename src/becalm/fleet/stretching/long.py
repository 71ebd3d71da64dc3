"""Describe a sensor that is cut in time; the tasks of all its stretches receive this description."""

from __future__ import annotations

from typing import NamedTuple

from becalm.files.shared_source import ParsedSource
from becalm.fleet.job import Job, Sensor
from becalm.fleet.pieces import OutputFile

State = tuple[bytes, ...]
"""Packed states of the filters, one for each channel."""


class Extremes(NamedTuple):
    """The range of the readings before a row."""

    row: int
    least: tuple[float, ...]  # one for each channel
    most: tuple[float, ...]


class Long(NamedTuple):
    """A sensor that is cut in time."""

    job: Job
    sensor: Sensor
    recipe: str  # the text of its recipe, fitted to its channels
    causal: bool  # whether estimates use only the past
    known: ParsedSource
    files: tuple[OutputFile, ...]  # one for each input file, in order
    staged: str  # the staging folder of its output
    hashed: str  # the hash of its input
    cuts: tuple[int, ...]  # the first row of each stretch, and the number of rows
    first: tuple[float, ...]  # the first usable reading of each channel
    extremes: tuple[Extremes, ...]
    notes: tuple[str, ...]  # sentences about its files and clock
    took_s: float  # the time of the survey, in seconds


class TaskStretch(NamedTuple):
    """A part of one sensor's rows, to be cleaned in a task."""

    number: int
    first: int
    stop: int
    state: State | None = None  # the filters' state after the rows before it, if that is known
