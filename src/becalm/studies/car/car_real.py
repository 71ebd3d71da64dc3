"""Apply the three-sensor model to a real car: speed from the CAN bus, and an accelerometer with another clock.

The process noise is white noise in the derivative of each acceleration. The model is discretised exactly over the time
between two readings. Its densities and the noise of each sensor are estimated by maximum likelihood.
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
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.files.inputs.opening import read

FOLDER = "comma2k19"
_SLOPE_S = 0.25  # half-width of the window for the slope of the speed
_HIDDEN_S, _PERIOD_S = 1.0, 4.0  # the speed is hidden for the last second of every four
_EVALUATIONS = 1200  # most evaluations of the likelihood


class CarRecord(NamedTuple):
    """The readings of a car, N rows; NaN where a sensor has no reading at that time."""

    times_s: Floats  # (N,)
    readings: Floats  # (N, 3) speed m/s, acceleration along and up m/s^2
    offset: float  # m/s^2, subtracted from the acceleration along; due to tilt of the sensor and slope of the road


class Fitted(NamedTuple):
    """The noise parameters that were estimated by maximum likelihood."""

    jerk_density: Floats  # (2,) noise density of the derivative of the accelerations along and up, (m/s^3)^2/Hz
    noise_std: Floats  # (3,) speed in m/s, accelerations in m/s^2


class RealCar(NamedTuple):
    """The results of the three-sensor model on a real car."""

    record: CarRecord
    fitted: Fitted
    estimate: Floats  # (N, 3) causal estimates
    slope: Floats  # (N,) derivative of the measured speed, m/s^2, by a non-causal fit; NaN at the ends and in gaps
    raw_rms: float  # m/s^2, difference of the readings of the acceleration along from the slope
    estimate_rms: float  # m/s^2, difference of the estimate from the slope
    accelerometer_rms: float  # m/s^2, difference of the estimate without the speed from the slope
    raw_correlation: float  # of the readings of the acceleration along with the slope
    estimate_correlation: float  # of the estimate with the slope
    alone_correlation: float  # of the estimate without the speed with the slope
    hidden_rms: float  # m/s, error of the speed where it was hidden, estimated from the accelerometer
    held_rms: float  # m/s, error of holding the last speed instead
    hidden_count: int  # number of hidden speeds


def load(recordings: Path) -> CarRecord | None:
    """Read the recordings of the car from folder `comma2k19`; None if they are missing."""
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
    """Run the three-sensor model on the recordings of the car; None if they are missing."""
    record = load(recordings)
    if record is None:
        return None
    z, times = record.readings, record.times_s
    fitted = fit(times, z)
    estimate = run_three_sensors(times, z, fitted).signal
    first_speed_only = z.copy()
    first_speed_only[np.isfinite(z[:, 0]).nonzero()[0][1:], 0] = np.nan  # the first speed starts the filter
    without_speed = run_three_sensors(times, first_speed_only, fitted).signal
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


def run_three_sensors(times_s: Floats, readings: Floats, fitted: Fitted, *, with_estimates: bool = True) -> Estimate:
    """Filter readings (N, 3) at times (N,), in s, causally; without `with_estimates`, compute only the likelihood."""
    elapsed = np.diff(times_s, prepend=times_s[0])
    timeline = elapsed_timeline(_component(fitted.jerk_density), 1.0, elapsed)
    R = np.diag(fitted.noise_std**2)
    F, Q, H, _ = timeline.system
    timeline = timeline._replace(system=timeline.system._replace(R=R))
    wanted = WantedResults(sigma=with_estimates, innovations=with_estimates, signal=with_estimates)
    return run_filter(Model(F[0], H, Q[0], R), timeline, readings, wanted).estimate


def fit(times_s: Floats, readings: Floats) -> Fitted:
    """Estimate the noise parameters by maximum likelihood, starting at a rough guess."""
    spread = [float(np.nanstd(readings[:, k])) / 2 for k in (1, 2)]
    rough = np.log([10.0, 10.0, 0.05, *spread])

    def cost(theta: Floats) -> float:
        numbers: Floats = np.exp(theta)
        tried = Fitted(numbers[:2], numbers[2:])
        return -run_three_sensors(times_s, readings, tried, with_estimates=False).log_likelihood

    best = minimize(cost, rough, method="Nelder-Mead", options={"maxfev": _EVALUATIONS, "xatol": 1e-2, "fatol": 0.1})
    numbers: Floats = np.exp(np.asarray(best.x))
    return Fitted(numbers[:2], numbers[2:])


def slope_of_speed(times_s: Floats, speed: Floats) -> Floats:
    """Return the slope (N,) of a line fitted to the speeds (N,) around each time; NaN at the ends and in gaps."""
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
    """Hide the speed for the last second of every four; estimate it by the filter, and by holding the last speed."""
    phase = np.mod(times_s - times_s[0], _PERIOD_S)
    hidden = np.isfinite(readings[:, 0]) & (phase >= _PERIOD_S - _HIDDEN_S)
    shown = readings.copy()
    shown[hidden, 0] = np.nan
    estimated = run_three_sensors(times_s, shown, fitted).signal[:, 0]
    last = np.maximum.accumulate(np.where(np.isfinite(shown[:, 0]), np.arange(len(shown)), 0))
    true = readings[hidden, 0]
    by_filter, by_holding = (float(np.sqrt(np.mean((v[hidden] - true) ** 2))) for v in (estimated, shown[last, 0]))
    return _Hidden(by_filter, by_holding, int(hidden.sum()))
