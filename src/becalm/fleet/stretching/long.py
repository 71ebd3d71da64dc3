"""A sensor that is cut in time: what all of its stretches know of it."""

from __future__ import annotations

from typing import NamedTuple

from becalm.files.shared_source import ParsedSource
from becalm.fleet.job import Job, Sensor
from becalm.fleet.pieces import OutputFile

State = tuple[bytes, ...]
"""What filters stand at, or leave, packed: of each channel."""


class Extremes(NamedTuple):
    """Between what readings lay before a row."""

    row: int
    least: tuple[float, ...]  # of each channel
    most: tuple[float, ...]


class Long(NamedTuple):
    """A sensor that is cut in time."""

    job: Job
    sensor: Sensor
    recipe: str  # the text of its recipe, fitted to it
    causal: bool  # whether estimates know only the past
    known: ParsedSource
    files: tuple[OutputFile, ...]  # that it came in, in order
    staged: str  # the folder in which its output waits for its name
    hashed: str  # what its output comes of
    cuts: tuple[int, ...]  # the rows at which stretches begin, and the last row's end
    first: tuple[float, ...]  # the first usable reading of each channel
    extremes: tuple[Extremes, ...]
    notes: tuple[str, ...]  # what was found of its files and clock
    took_s: float  # to find all that out


class TaskStretch(NamedTuple):
    """A part of one sensor's rows, to be cleaned in a task."""

    number: int
    first: int
    stop: int
    state: State | None = None  # what the rows before it leave, where that is known
