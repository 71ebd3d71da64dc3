"""Survey a long sensor before it is cut in time: find its clock, first readings, range of readings, and the cuts."""

from __future__ import annotations

from itertools import accumulate
from time import monotonic

import numpy as np
import pyarrow.parquet as pq

from becalm.cleaning.channels.faults import SensorWatch
from becalm.cleaning.channels.filters import Filter
from becalm.cleaning.recipes.limits_entry import outlier_test_rows
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import judge
from becalm.files.inputs.shared_source import parse_source
from becalm.files.outputs.chunked_cleaning import columns_of, rows_of_chunks
from becalm.fleet.job import Job, Sensor
from becalm.fleet.outcome import Outcome
from becalm.fleet.pieces import open_staging
from becalm.fleet.sensor_cleaning import (
    OpenedSensor,
    clean_whole,
    finished,
    hash_of,
    notes_of,
    open_sensor,
    refuse_foreign,
    refuse_on_error,
)
from becalm.fleet.stretching.long_sensor import Extremes, LongSensor
from becalm.fleet.stretching.margins import margin_of

FEWEST = 4
"""Smallest length of a stretch, in margins; for shorter stretches the warm-up would take too long."""


def survey(job: Job, sensor: Sensor) -> LongSensor | Outcome:
    """Return the description of a sensor that can be cut; clean any other sensor at once, and return its outcome.

    Parameters
    ----------
    job : Job
        The job over the lake.
    sensor : Sensor
        A sensor that may be long.
    """
    return refuse_on_error(sensor, lambda: _survey(job, sensor))


def _survey(job: Job, sensor: Sensor) -> LongSensor | Outcome:
    if job.tables_of(sensor)[0].count < 2 * job.stretch_rows:
        return clean_whole(job, sensor)
    hashed = hash_of(job, sensor)
    if kept := finished(job, sensor, hashed):
        return kept
    return _describe_long(job, sensor, hashed) or clean_whole(job, sensor)


def _describe_long(job: Job, sensor: Sensor, hashed: str) -> LongSensor | None:
    began, parts = monotonic(), open_sensor(job, sensor)
    with parts.source as source:
        margin = margin_of(parts.recipe, source.clock.step_s)
        length = max(job.stretch_rows, int(min(FEWEST * margin.readings, source.rows)))
        length = -(-length // margin.aligned) * margin.aligned
        if parts.recipe.mode == "lagged" or source.rows < 2 * length:
            return None
        refuse_foreign(job, sensor, [piece.name for piece in parts.pieces])
        staged = open_staging(job.output_folder(sensor))
        return LongSensor(
            job=job,
            sensor=sensor,
            recipe=parts.recipe.to_toml(),
            causal=parts.recipe.mode == "causal",
            parsed_source=parse_source(source, staged / "stamps"),
            files=parts.pieces,
            staged=str(staged),
            hashed=hashed,
            cuts=_cuts(source.rows, length),
            first=_first_readings(parts),
            extremes=_extremes(parts) if parts.as_stored else (),
            notes=notes_of(source),
            took_s=monotonic() - began,
        )


def _cuts(rows: int, length: int) -> tuple[int, ...]:
    """Return the first row of each stretch, followed by the number of rows; the last stretch may be longer."""
    return (*range(0, rows - length + 1, length), rows)


def _first_readings(parts: OpenedSensor) -> tuple[float, ...]:
    """Return, for each channel, the first reading that its filter may use; NaN if there is none."""
    step_s, channels = parts.source.clock.step_s, parts.recipe.channel
    first = np.full(len(channels), np.nan)
    lag = None if parts.recipe.mode == "smoothed" else 0  # recipes with a lag are never cut
    ahead = [0 if one.motion is None else outlier_test_rows(one.limits, lag) for one in channels]
    watches = [
        SensorWatch(channels[c].limits, step_s, has_innovations=False, ahead=ahead[c]) for c in range(len(channels))
    ]
    largest = [_largest(channel, step_s) for channel in channels]
    for chunk in parts.source.chunks(rows_of_chunks(parts.source, len(channels))):
        for c, column in enumerate(columns_of(chunk, parts.recipe)):
            readings, _ = watches[c].push(column, chunk.elapsed_steps)
            if np.isnan(first[c]):
                first[c] = _first_finite(judge(readings, largest[c]).readings)
        if not np.isnan(first).any():
            break
    for c in np.flatnonzero(np.isnan(first)).tolist():
        first[c] = _first_finite(judge(watches[c].finish()[0], largest[c]).readings)
    return tuple(first.tolist())


def _largest(channel: ChannelRecipe, step_s: float) -> float:
    return np.inf if channel.motion is None else Filter(channel, step_s, 0).largest_magnitude


def _first_finite(readings: Floats) -> float:
    finite = np.flatnonzero(np.isfinite(readings))
    return float(readings[finite[0]]) if len(finite) else np.nan


def _extremes(parts: OpenedSensor) -> tuple[Extremes, ...]:
    """Return the range of readings up to the end of each row group, from file statistics; () if these are absent."""
    extremes, row, names = [], 0, [channel.name for channel in parts.recipe.channel]
    for path in parts.paths:
        with pq.ParquetFile(path) as file:
            groups = [file.metadata.row_group(number) for number in range(file.num_row_groups)]
        for group in groups:
            stored = {group.column(c).path_in_schema: group.column(c).statistics for c in range(group.num_columns)}
            ranges = [one for name in names if (one := stored.get(name)) is not None and _is_of_numbers(one)]
            if len(ranges) < len(names):
                return ()
            row += group.num_rows
            extremes.append(Extremes(row, tuple(one.min for one in ranges), tuple(one.max for one in ranges)))
    return tuple(accumulate(extremes, _join_extremes))


def _is_of_numbers(stored: pq.Statistics) -> bool:
    """Return whether statistics contain the range of a column of numbers; for a column of text they do not."""
    return bool(stored.has_min_max and isinstance(stored.min, int | float))


def _join_extremes(one: Extremes, other: Extremes) -> Extremes:
    return Extremes(
        other.row,
        tuple(map(min, one.least, other.least)),
        tuple(map(max, one.most, other.most)),
    )
