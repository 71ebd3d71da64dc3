"""Compare the filter that becalm identifies, an IMM, with the fixed gain of the IMU paper's optimum.

A record is white noise of variance 1 at 10 kHz, with a step after a rest. becalm's result does not depend on units.
Therefore the noise at rest relative to that of a reading, and the time to follow the step, hold for both of the paper's
sensors.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.cleaning.pipeline import clean
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.recording import Recording
from becalm.identification.several.step_spectrum import Sensor, StepTrial
from becalm.identification.wishes.noise_against_lag import trade_off_curve
from becalm.studies.imu.imu_records import PRINTED, RATE_HZ, SENSORS
from becalm.studies.imu.imu_responses import reached_ms

REST_S = 8.0  # duration of the rest before the step
SETTLED_S = 4.0  # noise at rest is measured from here on
AFTER_S = 2.0  # duration of the record from the step on
SEEDS = range(2)
STEPS = (0.2, 0.05, 0.02, 0.005)
"""Steps of the accelerometer in its unit; the simulation divides them by the standard deviation of its noise."""


class SwitchedStep(NamedTuple):
    """The results of the IMM for one height of the step; medians over the records.

    Attributes
    ----------
    step_std : float
        Step in standard deviations of a reading.
    reached_ms : float
        Time from the step until the output first exceeds nine tenths of it; inf if it does not within `AFTER_S`.
    rest_gain : float
        Root mean square of the output at rest, from `SETTLED_S` on, relative to the standard deviation of a reading.
    """

    step_std: float
    reached_ms: float
    rest_gain: float


class PrintedOptimum(NamedTuple):
    """The results of the paper's optimum for one sensor, on records of the same kind; fields as in `SwitchedStep`."""

    sensor: Sensor
    reached_ms: float
    rest_gain: float


class GainCurve(NamedTuple):
    """The fixed gains of one kinematic order: noise at rest against the time to nine tenths, as in `SwitchedStep`."""

    order: int
    reached_ms: Floats  # (k,)
    rest_gain: Floats  # (k,)


class ImmComparison(NamedTuple):
    """The results of the IMM, of the paper's optimum, and of other fixed gains."""

    switched: tuple[SwitchedStep, ...]
    fixed: tuple[PrintedOptimum, ...]
    gain_curves: tuple[GainCurve, ...]

    @property
    def rest_gain(self) -> float:
        """Return the noise of the IMM at rest relative to that of a reading, median over all steps."""
        return float(np.median([each.rest_gain for each in self.switched]))


def compare_imm() -> ImmComparison:
    """Run the IMM on records with each step, and the paper's optimum for each sensor on records at rest."""
    std = np.sqrt(PRINTED["accelerometer"].measured_noise)
    switched = tuple(_switched(step / std) for step in STEPS)
    fixed = tuple(_fixed(sensor) for sensor in SENSORS)
    points = trade_off_curve(1.0, 1 / RATE_HZ).points
    gain_curves = tuple(
        GainCurve(
            order,
            np.array([1e3 * point.step_90_s for point in points if point.order == order]),
            np.array([point.noise_std for point in points if point.order == order]),
        )
        for order in sorted({point.order for point in points})
    )
    return ImmComparison(switched, fixed, gain_curves)


def _record(step_std: float, seed: int) -> Floats:
    """Return noise (N,) of variance 1, with a step at the end of the rest; the noise depends on the step's height."""
    rest, after = round(REST_S * RATE_HZ), round(AFTER_S * RATE_HZ)
    z = np.random.default_rng([seed, round(1e3 * step_std)]).normal(size=rest + after)
    z[rest:] += step_std
    return z


def _switched(step_std: float) -> SwitchedStep:
    rest, settled = round(REST_S * RATE_HZ), round(SETTLED_S * RATE_HZ)
    times_ms, gains = [], []
    for seed in SEEDS:
        recording = Recording(_record(step_std, seed), rate_hz=RATE_HZ)
        x = clean(recording, causal=True).signal.samples[:, 0]
        reached = np.flatnonzero(x[rest:] > 0.9 * step_std)
        times_ms.append(1e3 * float(reached[0]) / RATE_HZ if len(reached) else np.inf)
        gains.append(float(np.sqrt(np.mean(x[settled:rest] ** 2))))
    return SwitchedStep(step_std, float(np.median(times_ms)), float(np.median(gains)))


def _fixed(sensor: Sensor) -> PrintedOptimum:
    """Run the paper's optimum on records at rest; compute its time to follow a step from the model, without noise."""
    rest, settled, ratio = round(REST_S * RATE_HZ), round(SETTLED_S * RATE_HZ), PRINTED[sensor].ratio
    records = [_record(STEPS[0], seed)[:rest] for seed in SEEDS]
    model = StepTrial(records[0], RATE_HZ, sensor).model(1.0, ratio)
    outputs = [kalman_filter(model, z, sigma=False, innovations=False).signal[settled:, 0] for z in records]
    gain = np.median([np.sqrt(np.mean(x**2)) for x in outputs])
    return PrintedOptimum(sensor, reached_ms(sensor, ratio), float(gain))
