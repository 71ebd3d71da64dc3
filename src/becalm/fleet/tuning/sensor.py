"""Tune one sensor in a task, on a sample of its rows; in a later task, run its class's recipe on the same rows."""

from __future__ import annotations

from pathlib import Path
from time import monotonic

import numpy as np

from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.tuning import calibrated, tune
from becalm.core.recording import Recording
from becalm.files.inputs.opening import OpenSource, open_source
from becalm.files.inputs.portions import rows_to_tune_on
from becalm.fleet.job import Job, Sensor
from becalm.fleet.outcome import SHOWN, Outcome
from becalm.fleet.sensor_cleaning import open_sensor, refuse_on_error
from becalm.fleet.tuning.sensor_tuning import SensorTuning, TunedChannel
from becalm.report.fleet.fleet_rows import FleetRow, row_of


def tune_sensor(lake: str, causal: bool, sensor: Sensor) -> SensorTuning | Outcome:
    """Tune the recipe of a sensor; after an error, return a refusal with the reason and raise nothing.

    Parameters
    ----------
    lake : str
        A folder that every worker sees under this path.
    causal : bool
        True for causal filters, false for smoothers.
    sensor : Sensor
        One sensor of the lake.

    Returns
    -------
    SensorTuning or Outcome
        The result; an Outcome with the reason if the sensor could not be tuned.
    """
    return refuse_on_error(sensor, lambda: _tune(Path(lake) / sensor.name, causal, sensor.name))


def judge_sensor(job: Job, sensor: Sensor) -> Outcome:
    """Run a recipe on the rows that the sensor's own recipe was tuned on; raise and write nothing.

    Parameters
    ----------
    job : Job
        The job with the recipe; its output is not used.
    sensor : Sensor
        One sensor of the lake.
    """
    return refuse_on_error(sensor, lambda: _judge(job, sensor))


def _tune(place: Path, causal: bool, name: str) -> SensorTuning:
    began = monotonic()
    with open_source(place) as source:
        sample = source.sample(rows_to_tune_on(source))
        recipe = _with_origin(tune(sample, causal=causal), source)
        rows = _rows(name, sample, recipe, source.rate_hz)
    channels = [_channel(name, recipe, row, sample) for row in rows]
    return SensorTuning(name, recipe, tuple(channels), monotonic() - began)


def _with_origin(recipe: Recipe, source: OpenSource) -> Recipe:
    """Return a recipe with the hash of the file that it was tuned on, and with the calibrations of its channels."""
    origin = recipe.tuned_on.model_copy(update={"sha256": source.sha256()})
    return recipe.model_copy(update={"tuned_on": origin, "channel": calibrated(recipe.channel, source.calibrations)})


def _judge(job: Job, sensor: Sensor) -> Outcome:
    began, parts = monotonic(), open_sensor(job, sensor)
    with parts.source as source:
        sample = source.sample(rows_to_tune_on(source))
        rows = _rows(sensor.name, sample, parts.recipe, source.rate_hz, sensor.recipe[:SHOWN])
    return Outcome(sensor.name, "cleaned", tuple(rows), monotonic() - began)


def _rows(sensor: str, sample: Recording, recipe: Recipe, rate_hz: float, hashed: str = "") -> list[FleetRow]:
    """Clean a sample with a recipe, and return a row of the report for each channel."""
    reports = clean(sample, recipe).reports
    return [row_of(sensor, report, recipe=hashed, rate_hz=rate_hz) for report in reports]


def _channel(sensor: str, recipe: Recipe, row: FleetRow, sample: Recording) -> TunedChannel:
    own = next(channel for channel in recipe.channel if channel.name == row.channel)
    readings = sample.channel(row.channel)
    largest = np.inf if own.limits is None or own.limits.largest is None else own.limits.largest
    valid = readings[np.isfinite(readings) & (np.abs(readings) <= largest)]
    span = (float(valid.min()), float(valid.max())) if len(valid) else (np.nan, np.nan)
    return TunedChannel(sensor, own, row, *span)
