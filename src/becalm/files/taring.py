"""The zeros of sensors, taken from stretches of a file before the rest of it is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.files.calibrated_rows import Sensed, SensedRows
from becalm.files.read_options import ReadOptions
from becalm.files.roles import values_of
from becalm.files.source import RawTable
from becalm.files.timing.row_times import RowTimes, row_times, rows_between
from becalm.sensors.curve import CalibrationCurve
from becalm.sensors.record import tared
from becalm.sensors.tare import MOST_READINGS, Tare, zero_of

_AS_READ = CalibrationCurve((0.0, 1.0))


def with_tares(table: RawTable, sensed: Sequence[Sensed], options: ReadOptions) -> list[Sensed]:
    """Take the zeros that sensors ask for.

    Parameters
    ----------
    table : RawTable
        As it is in the file.
    sensed : sequence of Sensed
        Its sensors.
    options : ReadOptions
        With what was said of its time.

    Raises
    ------
    SensorError
        If a stretch is not within the rows, not quiet, or too short.
    InputError
        If the time of the rows cannot be understood.
    """
    if all(one.record.tare_s is None for one in sensed):
        return list(sensed)
    as_read = [one if one.record.tare_s is None else _as_read(one) for one in sensed]
    readings = replace(table, rows=SensedRows(table.rows, as_read, table.decimal))
    if options.group not in (None, table.group):  # what was said of the time is not of this one
        options = replace(options, time=None, rate_hz=None)
    times = row_times(table, options)
    try:
        return [one if one.record.tare_s is None else _tared(one, readings, times) for one in sensed]
    finally:
        if times.stamps is not None:
            times.stamps.close()


def _as_read(one: Sensed) -> Sensed:
    """Return a sensor that tells its readings, less those that are clipped."""
    bare = replace(
        one.record, conversion=_AS_READ, unit=one.record.raw_unit, reading_size=1.0, result_size=1.0, temperature=None
    )
    return one._replace(record=bare, thermometer=None)


def _tared(one: Sensed, readings: RawTable, times: RowTimes) -> Sensed:
    (channel,), (start_s, stop_s) = one.columns, one.record.tare_s or (0.0, 0.0)
    try:
        first, stop = rows_between(times, start_s, stop_s)
        if stop - first > MOST_READINGS:
            raise SensorError(f"It has {stop - first} rows; {MOST_READINGS} are enough. Give a shorter one.")
        value, std, count = zero_of(_stretch(readings, one.names[0], first, stop))
        tare = Tare(
            start_s,
            stop_s,
            value,
            float(std) if np.isfinite(std) else None,
            one.record.raw_unit,
            count,
            _temperature(one, readings, first, stop),
        )
        return one._replace(record=tared(one.record, tare), tare=tare)
    except SensorError as cause:
        raise SensorError(
            f"The zero of {channel!r} cannot be taken from {start_s:g} s to {stop_s:g} s, as its tare says: {cause}"
        ) from cause


def _temperature(one: Sensed, readings: RawTable, first: int, stop: int) -> float | None:
    """Return how warm it was, in degC; None where it is not known."""
    if one.record.temperature is None:
        return None
    if one.thermometer is None:
        return one.record.temperature.constant_degc
    column, size = one.thermometer
    degc = _stretch(readings, column, first, stop) * size.factor + size.offset
    seen = degc[np.isfinite(degc)]
    if not len(seen):
        raise SensorError(f"{column!r}, which tells its temperature, has no readings there. Give another stretch.")
    return float(seen.mean())


def _stretch(table: RawTable, name: str, first: int, stop: int) -> Floats:
    """Read a column from one row up to another."""
    parts, left = [np.empty(0)], stop - first
    for block in table.blocks([name], first):
        if left <= 0:
            break
        parts.append(values_of(block.column(0).slice(0, left), table.decimal))
        left -= block.num_rows
    return np.concatenate(parts)
