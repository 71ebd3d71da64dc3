"""Compute step responses of the IMU paper's filters, for its figures 5, 6 and 9; R, Q and P0 vary one at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.steady.response import describe
from becalm.identification.several.step_spectrum import Sensor, StepTrial
from becalm.studies.imu.imu_records import PRINTED, RATE_HZ

STEP = 0.2  # height, in unit
STEP_AT_S = 5.0
FIGURE_STRIDE = 50
"""Rows of a response per point of a figure."""

_LAST = round(0.1 * RATE_HZ)  # number of rows at the end over which the output is averaged


class NoiseSetting(NamedTuple):
    """R and Q in unit^2, and the value of all entries of P0."""

    name: str
    noise_variance: float
    process_variance: float
    start: float = 1.0


class FilterResponse(NamedTuple):
    """The response of one filter to the step.

    Attributes
    ----------
    setting : NoiseSetting
        R, Q and P0 of the filter.
    output : (k,) float array
        Every `FIGURE_STRIDE`-th row of the output, in unit, from the first on.
    reached_ms : float
        Time from the step until the output first reaches nine tenths of the step; inf if it never does.
    rest_noise : float
        Standard deviation of the output over the last second before the step, in unit.
    rest_offset : float
        Mean of the output over the last second before the step, in unit; the mean of the record was subtracted.
    risen : float
        Output at the end of the record, averaged over a tenth of a second, relative to the step.
    differs : float
        Largest difference between output and input from the second reading on, in unit.
    """

    setting: NoiseSetting
    output: Floats
    reached_ms: float
    rest_noise: float
    rest_offset: float
    risen: float
    differs: float


def settings(sensor: Sensor) -> tuple[NoiseSetting, ...]:
    """Return R, Q and P0 in the panels of figure 5 (accelerometer) or 6 (gyroscope)."""
    R, Q, *_ = PRINTED[sensor]
    panels = (
        NoiseSetting("a", 0.0, Q),
        NoiseSetting("b", 1.0, Q),
        NoiseSetting("c", R, 0.0),
        NoiseSetting("d", R, 1.0),
    )
    return panels if sensor == "gyroscope" else (*panels, NoiseSetting("e", R, Q, 0.0), NoiseSetting("f", R, Q))


def compute_response(sensor: Sensor, record: Floats, setting: NoiseSetting) -> FilterResponse:
    """Return the response of one filter to a motionless record (N,), in unit, plus a step of 0.2 after 5 s."""
    P0 = np.full((2, 2), setting.start)
    trial = StepTrial(record, RATE_HZ, sensor, step=STEP, step_at_s=STEP_AT_S, initial_covariance=P0)
    model = trial.model(setting.noise_variance, setting.process_variance)
    row, second = round(STEP_AT_S * RATE_HZ), round(RATE_HZ)
    z = record - record.mean()
    z[row:] += STEP
    x = kalman_filter(model, z, sigma=False, innovations=False).signal[:, 0]
    reached = np.flatnonzero(x[row:] >= 0.9 * STEP)
    rest = x[row - second : row]
    return FilterResponse(
        setting,
        x[::FIGURE_STRIDE].copy(),
        1e3 * float(reached[0]) / RATE_HZ if len(reached) else np.inf,
        float(rest.std()),
        float(rest.mean()),
        float(x[-_LAST:].mean() / STEP),
        float(np.abs(x - z)[1:].max()),
    )


def compute_responses(sensor: Sensor, record: Floats) -> tuple[FilterResponse, ...]:
    """Return the responses in all panels of figure 5 or 6."""
    return tuple(compute_response(sensor, record, setting) for setting in settings(sensor))


def reached_ms(sensor: Sensor, ratio: float) -> float:
    """Return the time, in ms, in which the steady-state filter of a Q/R reaches nine tenths of a step."""
    any_record = np.zeros(2 * round(STEP_AT_S * RATE_HZ))
    step = describe(StepTrial(any_record, RATE_HZ, sensor).model(1.0, ratio), 1 / RATE_HZ).step
    assert step is not None  # a kinematic model passes 0 Hz
    return 1e3 * step.delay_90_s
