"""A real car: the three-sensor model with the speed of its CAN bus and an accelerometer, each on its own clock.

The process noise is white on the derivative of each acceleration, discretised exactly over whatever time lies between
two readings; its densities and the noise of each sensor are found by likelihood.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from becalm.core.arrays import Floats, frozen
from becalm.core.filter.filtering import Estimate, WantedResults, run_filter
from becalm.core.model.components import Component, Part
from becalm.core.model.model import Model
from becalm.core.model.timeline import elapsed_timeline
from becalm.files.reading import read

FOLDER = "comma2k19"
_SLOPE_S = 0.25  # on either side: a line through the speed tells its derivative
_HIDDEN_S, _PERIOD_S = 1.0, 4.0  # of each period, so much of the speed is hidden
_EVALUATIONS = 1200


class CarRecord(NamedTuple):
    """Readings of a car, NaN where a sensor said nothing at a time; N rows."""

    times_s: Floats  # (N,)
    readings: Floats  # (N, 3) speed m/s, acceleration along and up m/s^2
    offset: float  # m/s^2, taken off the acceleration along: tilt of the sensor, and the mean slope


class Fitted(NamedTuple):
    """What likelihood found."""

    jerk_density: Floats  # (2,) of the noise on the derivative of the accelerations, (m/s^3)^2/Hz, along and up
    noise_std: Floats  # (3,) of speed m/s, accelerations m/s^2


class RealCar(NamedTuple):
    """The three-sensor model on a real car."""

    record: CarRecord
    fitted: Fitted
    estimate: Floats  # (N, 3) filtered causally
    slope: Floats  # (N,) derivative of the speed alone, not causal; NaN at the ends
    raw_rms: float  # m/s^2, acceleration along as read against the slope
    estimate_rms: float  # m/s^2, as estimated
    accelerometer_rms: float  # m/s^2, as estimated without the speed
    raw_correlation: float
    estimate_correlation: float
    alone_correlation: float
    hidden_rms: float  # m/s, speed estimated where it was hidden, the accelerometer being read
    held_rms: float  # m/s, the last speed held instead
    hidden_count: int


def load(recordings: Path) -> CarRecord | None:
    """Read the car of `comma2k19` below a folder; None where it is not."""
    paths = [recordings / FOLDER / name for name in ("accelerometer.csv", "can_speed.csv")]
    if not all(path.exists() for path in paths):
        return None
    accelerometer, speed = (read(path) for path in paths)
    v, a = speed.samples[:, 0], accelerometer.samples
    gained = (v[-1] - v[0]) / (speed.times_s[-1] - speed.times_s[0])
    offset = float(a[:, 0].mean() - gained)
    when = [accelerometer.times_s, speed.times_s]
    times = np.unique(np.concatenate(when))
    readings = np.full((len(times), 3), np.nan)
    readings[np.searchsorted(times, when[0]), 1:] = np.column_stack([a[:, 0] - offset, a[:, 2].mean() - a[:, 2]])
    readings[np.searchsorted(times, when[1]), 0] = v
    return CarRecord(times, readings, offset)


def study_real_car(recordings: Path) -> RealCar | None:
    """Run the three-sensor model on the car below a folder of recordings; None where it is not."""
    record = load(recordings)
    if record is None:
        return None
    z, times = record.readings, record.times_s
    fitted = fit(times, z)
    estimate = run_three_sensors(times, z, fitted).signal
    deaf = z.copy()
    deaf[np.isfinite(z[:, 0]).nonzero()[0][1:], 0] = np.nan  # the first speed starts the filter
    without_speed = run_three_sensors(times, deaf, fitted).signal
    slope = slope_of_speed(times, z[:, 0])
    compared = np.isfinite(slope) & np.isfinite(z[:, 1])
    along = slope[compared]

    def rms(values: Floats) -> float:
        return float(np.sqrt(np.mean((values[compared] - along) ** 2)))

    def correlation(values: Floats) -> float:
        return float(np.corrcoef(values[compared], along)[0, 1])

    return RealCar(
        record,
        fitted,
        estimate,
        slope,
        raw_rms=rms(z[:, 1]),
        estimate_rms=rms(estimate[:, 1]),
        accelerometer_rms=rms(without_speed[:, 1]),
        raw_correlation=correlation(z[:, 1]),
        estimate_correlation=correlation(estimate[:, 1]),
        alone_correlation=correlation(without_speed[:, 1]),
        **_hide(times, z, fitted)._asdict(),
    )


def _component(jerk_density: Floats) -> Component:
    drift, noise_input = np.zeros((3, 3)), np.zeros((3, 2))
    drift[0, 1] = noise_input[1, 0] = noise_input[2, 1] = 1.0
    part = Part("car", ("speed", "acceleration along", "acceleration up"))
    return Component(frozen(drift), frozen(noise_input), frozen(np.diag(jerk_density)), frozen(np.eye(3)), (part,))


def run_three_sensors(times_s: Floats, readings: Floats, fitted: Fitted, *, all_of_it: bool = True) -> Estimate:
    """Filter readings (N, 3) at their own times (N,) causally; only the likelihood where not all is wanted."""
    elapsed = np.diff(times_s, prepend=times_s[0])
    timeline = elapsed_timeline(_component(fitted.jerk_density), 1.0, elapsed)
    R = np.diag(fitted.noise_std**2)
    F, Q, H, _ = timeline.system
    timeline = timeline._replace(system=timeline.system._replace(R=R))
    wanted = WantedResults(sigma=all_of_it, innovations=all_of_it, signal=all_of_it)
    return run_filter(Model(F[0], H, Q[0], R), timeline, readings, wanted).estimate


def fit(times_s: Floats, readings: Floats) -> Fitted:
    """Find densities and noise by likelihood, from rough guesses on."""
    spread = [float(np.nanstd(readings[:, k])) / 2 for k in (1, 2)]
    rough = np.log([10.0, 10.0, 0.05, *spread])

    def cost(theta: Floats) -> float:
        numbers: Floats = np.exp(theta)
        tried = Fitted(numbers[:2], numbers[2:])
        return -run_three_sensors(times_s, readings, tried, all_of_it=False).log_likelihood

    best = minimize(cost, rough, method="Nelder-Mead", options={"maxfev": _EVALUATIONS, "xatol": 1e-2, "fatol": 0.1})
    found: Floats = np.exp(np.asarray(best.x))
    return Fitted(found[:2], found[2:])


def slope_of_speed(times_s: Floats, speed: Floats) -> Floats:
    """Return the slope (N,) of a line through the speeds (N,) around each time; NaN at the ends and in gaps."""
    seen = np.isfinite(speed)
    t, v = times_s[seen], speed[seen]
    first, last = (np.searchsorted(t, times_s + side * _SLOPE_S) for side in (-1, 1))
    sums = [np.concatenate([[0.0], np.cumsum(values)]) for values in (t, v, t * t, t * v)]
    St, Sv, Stt, Stv = (total[last] - total[first] for total in sums)
    count = last - first
    whole = (times_s - _SLOPE_S >= t[0]) & (times_s + _SLOPE_S <= t[-1]) & (count > 2)
    slope = np.full(len(times_s), np.nan)
    slope[whole] = ((count * Stv - St * Sv)[whole]) / ((count * Stt - St * St)[whole])
    return slope


class _Hidden(NamedTuple):
    hidden_rms: float
    held_rms: float
    hidden_count: int


def _hide(times_s: Floats, readings: Floats, fitted: Fitted) -> _Hidden:
    """Hide the speed for the last second of every four, and tell it from the accelerometer."""
    phase = np.mod(times_s - times_s[0], _PERIOD_S)
    hidden = np.isfinite(readings[:, 0]) & (phase >= _PERIOD_S - _HIDDEN_S)
    shown = readings.copy()
    shown[hidden, 0] = np.nan
    told = run_three_sensors(times_s, shown, fitted).signal[:, 0]
    last = np.maximum.accumulate(np.where(np.isfinite(shown[:, 0]), np.arange(len(shown)), 0))
    true = readings[hidden, 0]
    by_filter, by_holding = (float(np.sqrt(np.mean((v[hidden] - true) ** 2))) for v in (told, shown[last, 0]))
    return _Hidden(by_filter, by_holding, int(hidden.sum()))
