"""A long sensor looked over before it is cut in time: its clock, its levels, and where to cut."""

from __future__ import annotations

from itertools import accumulate
from time import monotonic

import numpy as np
import pyarrow.parquet as pq

from becalm.cleaning.faults import SensorWatch
from becalm.cleaning.filters import Filter
from becalm.cleaning.limits_entry import rows_that_judge
from becalm.cleaning.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.core.verdict import judge
from becalm.files.chunked_cleaning import columns_of, rows_of_chunks
from becalm.files.shared_source import known_of
from becalm.fleet.job import Job, Sensor
from becalm.fleet.outcome import Outcome
from becalm.fleet.pieces import open_staging
from becalm.fleet.sensor_cleaning import (
    OpenedSensor,
    clean_whole,
    finished,
    hash_of,
    notes_of,
    opened,
    refuse_foreign,
    told_by,
)
from becalm.fleet.stretching.long import Extremes, Long
from becalm.fleet.stretching.margins import margin_of

FEWEST = 4
"""Margins that a stretch is long, at least: of a shorter one too much would be done twice."""


def survey(job: Job, sensor: Sensor) -> Long | Outcome:
    """Look a sensor over; one that need not, or cannot, be cut is cleaned at once.

    Parameters
    ----------
    job : Job
        What is to be done.
    sensor : Sensor
        One that may be long.
    """
    return told_by(sensor, lambda: _looked_over(job, sensor))


def _looked_over(job: Job, sensor: Sensor) -> Long | Outcome:
    if job.tables_of(sensor)[0].count < 2 * job.stretch_rows:
        return clean_whole(job, sensor)
    hashed = hash_of(job, sensor)
    if kept := finished(job, sensor, hashed):
        return kept
    return _long(job, sensor, hashed) or clean_whole(job, sensor)


def _long(job: Job, sensor: Sensor, hashed: str) -> Long | None:
    began, found = monotonic(), opened(job, sensor)
    with found.source as source:
        margin = margin_of(found.recipe, source.clock.step_s)
        length = max(job.stretch_rows, int(min(FEWEST * margin.readings, source.rows)))
        length = -(-length // margin.aligned) * margin.aligned
        if found.recipe.mode == "lagged" or source.rows < 2 * length:
            return None
        refuse_foreign(job, sensor, [piece.name for piece in found.pieces])
        staged = open_staging(job.output_folder(sensor))
        return Long(
            job=job,
            sensor=sensor,
            recipe=found.recipe.to_toml(),
            causal=found.recipe.mode == "causal",
            known=known_of(source, staged / "stamps"),
            files=found.pieces,
            staged=str(staged),
            hashed=hashed,
            cuts=_cuts(source.rows, length),
            first=_first_readings(found),
            extremes=_extremes(found) if found.as_stored else (),
            notes=notes_of(source),
            took_s=monotonic() - began,
        )


def _cuts(rows: int, length: int) -> tuple[int, ...]:
    """Return where stretches of a length begin, the last of which takes what is left, and where it ends."""
    return (*range(0, rows - length + 1, length), rows)


def _first_readings(found: OpenedSensor) -> tuple[float, ...]:
    """Return the first reading of each channel that may enter its filter; NaN where there is none."""
    step_s, channels = found.source.clock.step_s, found.recipe.channel
    first, lag = np.full(len(channels), np.nan), None if found.recipe.mode == "smoothed" else 0  # a lag is not cut
    ahead = [0 if one.motion is None else rows_that_judge(one.limits, lag) for one in channels]
    watches = [SensorWatch(channels[c].limits, step_s, shown=False, ahead=ahead[c]) for c in range(len(channels))]
    largest = [_largest(channel, step_s) for channel in channels]
    for chunk in found.source.chunks(rows_of_chunks(found.source, len(channels))):
        for c, column in enumerate(columns_of(chunk, found.recipe)):
            readings, _ = watches[c].push(column, chunk.elapsed_steps)
            if np.isnan(first[c]):
                first[c] = _first(judge(readings, largest[c]).readings)
        if not np.isnan(first).any():
            break
    for c in np.flatnonzero(np.isnan(first)).tolist():
        first[c] = _first(judge(watches[c].finish()[0], largest[c]).readings)
    return tuple(first.tolist())


def _largest(channel: ChannelRecipe, step_s: float) -> float:
    return np.inf if channel.motion is None else Filter(channel, step_s, 0).largest


def _first(readings: Floats) -> float:
    known = np.flatnonzero(np.isfinite(readings))
    return float(readings[known[0]]) if len(known) else np.nan


def _extremes(found: OpenedSensor) -> tuple[Extremes, ...]:
    """Return between what the readings lay before each row group, as far as the files say; none where one does not."""
    told, row, names = [], 0, [channel.name for channel in found.recipe.channel]
    for path in found.paths:
        with pq.ParquetFile(path) as file:
            groups = [file.metadata.row_group(number) for number in range(file.num_row_groups)]
        for group in groups:
            stored = {group.column(c).path_in_schema: group.column(c).statistics for c in range(group.num_columns)}
            ranges = [one for name in names if (one := stored.get(name)) is not None and _is_of_numbers(one)]
            if len(ranges) < len(names):
                return ()
            row += group.num_rows
            told.append(Extremes(row, tuple(one.min for one in ranges), tuple(one.max for one in ranges)))
    return tuple(accumulate(told, _joined))


def _is_of_numbers(stored: pq.Statistics) -> bool:
    """Whether statistics tell between which numbers the values of a column lie; text is in another order."""
    return bool(stored.has_min_max and isinstance(stored.min, int | float))


def _joined(one: Extremes, other: Extremes) -> Extremes:
    return Extremes(
        other.row,
        tuple(map(min, one.least, other.least)),
        tuple(map(max, one.most, other.most)),
    )
