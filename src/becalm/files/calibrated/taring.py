"""Measure the zero offsets of sensors in given intervals at rest (tare), before the whole file is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import BEYOND_ANY_SENSOR
from becalm.errors import SensorError
from becalm.files.calibrated.calibrated_rows import CalibratedRows, MatchedSensor
from becalm.files.read_options import ReadOptions
from becalm.files.roles import values_of
from becalm.files.source import RawTable
from becalm.files.timing.times import RowTimes, row_times, rows_between
from becalm.sensors.curve import CalibrationCurve
from becalm.sensors.record import apply_tare
from becalm.sensors.tare import MOST_READINGS, Tare, zero_of

_IDENTITY = CalibrationCurve((0.0, 1.0))  # leaves readings unchanged


def measure_tares(table: RawTable, sensors: Sequence[MatchedSensor], options: ReadOptions) -> list[MatchedSensor]:
    """Measure the zero offset of each sensor that has a tare interval, and return the sensors with their offsets.

    Parameters
    ----------
    table : RawTable
        The table as it is in the file.
    sensors : sequence of MatchedSensor
        Its sensors.
    options : ReadOptions
        The options that select the table's time.

    Raises
    ------
    SensorError
        If an interval is outside the rows, too short or too long, the sensor is not at rest in it, or its temperature
        is missing there.
    InputError
        If the time of the rows cannot be interpreted.
    """
    if all(one.record.tare_s is None for one in sensors):
        return list(sensors)
    raw_sensors = [one if one.record.tare_s is None else _without_conversion(one) for one in sensors]
    readings = replace(table, rows=CalibratedRows(table.rows, raw_sensors, table.decimal))
    if options.group not in (
        None,
        table.group,
    ):  # the options select another table, so its time options do not apply here
        options = replace(options, time=None, rate_hz=None)
    times = row_times(table, options)
    try:
        return [one if one.record.tare_s is None else _measure_tare(one, readings, times) for one in sensors]
    finally:
        if times.stamps is not None:
            times.stamps.close()


def _without_conversion(one: MatchedSensor) -> MatchedSensor:
    """Return a sensor whose conversion keeps raw readings unchanged, except that clipped ones become NaN."""
    bare = replace(
        one.record, conversion=_IDENTITY, unit=one.record.raw_unit, reading_size=1.0, result_size=1.0, temperature=None
    )
    return one._replace(record=bare, thermometer=None)


def _measure_tare(one: MatchedSensor, readings: RawTable, times: RowTimes) -> MatchedSensor:
    (channel,), (start_s, stop_s) = one.columns, one.record.tare_s or (0.0, 0.0)
    try:
        first, stop = rows_between(times, start_s, stop_s)
        if stop - first > MOST_READINGS:
            raise SensorError(f"The interval has {stop - first} rows; at most {MOST_READINGS} are used. Shorten it.")
        _refuse_clipped(one, times.raw, first, stop)
        value, std, count = zero_of(_read_rows(readings, one.names[0], first, stop))
        tare = Tare(
            start_s,
            stop_s,
            value,
            float(std) if np.isfinite(std) else None,
            one.record.raw_unit,
            count,
            _temperature(one, readings, first, stop),
        )
        return one._replace(record=apply_tare(one.record, tare), tare=tare)
    except SensorError as cause:
        raise SensorError(
            f"The zero of {channel!r} cannot be measured in its tare interval, {start_s:g} s to {stop_s:g} s: {cause}"
        ) from cause


def _refuse_clipped(one: MatchedSensor, raw: RawTable, first: int, stop: int) -> None:
    """Raise an error if readings of the interval are clipped: the mean of the others is not the zero."""
    if (full_scale := one.record.full_scale) is None:
        return
    raw_readings = _read_rows(raw, one.columns[0], first, stop) * one.sizes[0].factor + one.sizes[0].offset
    clipped = full_scale.clipped(raw_readings[np.abs(raw_readings) <= BEYOND_ANY_SENSOR])
    if clipped.any():
        raise SensorError(
            f"{int(clipped.sum())} of its {len(clipped)} readings reach the end of full scale, {full_scale.low:g} to"
            f" {full_scale.high:g} {one.record.raw_unit}. Give an interval in which none does, or the zero itself."
        )


def _temperature(one: MatchedSensor, readings: RawTable, first: int, stop: int) -> float | None:
    """Return the mean temperature in the interval, in degC; None if the sensor has no temperature."""
    if one.record.temperature is None:
        return None
    if one.thermometer is None:
        return one.record.temperature.constant_degc
    column, size = one.thermometer
    degc = _read_rows(readings, column, first, stop) * size.factor + size.offset
    finite = degc[np.isfinite(degc)]
    if not len(finite):
        raise SensorError(f"The temperature column {column!r} has no readings there. Give another interval.")
    return float(finite.mean())


def _read_rows(table: RawTable, name: str, first: int, stop: int) -> Floats:
    """Read the rows from `first` up to `stop` of a column as float64."""
    parts, left = [np.empty(0)], stop - first
    for block in table.blocks([name], first):
        if left <= 0:
            break
        parts.append(values_of(block.column(0).slice(0, left), table.decimal))
        left -= block.num_rows
    return np.concatenate(parts)
