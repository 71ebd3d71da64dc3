"""Tuning by step and spectrum: the cost of the IMU paper, which weighs lag against the noise left.

J(R, Q) = int from t_s to t_f of (S - x)^2 dt + int from 0 to Fs/2 of |X(f)| df   (10)

In the first term x is the filter's output for a motionless record plus a step of S at t_s, and t_f the
first time that it reaches S; in the second X is the Welch spectrum of its output for the record alone.
Source: Kownacki (2010). The search for its least is in `becalm.identification.several.step_tuning`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from becalm.core.arrays import Floats, frozen
from becalm.core.filter.filtering import kalman_filter
from becalm.core.model.components import Component, Part
from becalm.core.model.model import Model
from becalm.errors import ModelError, RecordingError
from becalm.identification.spectrum import welch_power

Sensor = Literal["accelerometer", "gyroscope"]
SpectrumKind = Literal["amplitude", "power"]

SEGMENT = 1024
"""Readings in a segment of the Welch spectrum."""


def imu_component(sensor: Sensor, process_variance: float) -> Component:
    """Return the paper's model of an accelerometer or a gyroscope.

    Parameters
    ----------
    sensor : {"accelerometer", "gyroscope"}
        State [V, a], of which a is read and V never observed; or [omega, epsilon], of which omega is read.
    process_variance : float
        Q, of the noise on both states, in unit^2; after an Euler step of T, T^2 Q I. A *small* one
        trusts the model and smooths more.

    Raises
    ------
    ModelError
        If the sensor is another.
    """
    if sensor not in ("accelerometer", "gyroscope"):
        raise ModelError(f"sensor = {sensor!r} is not known; use 'accelerometer' or 'gyroscope'.")
    reads, names = {
        "accelerometer": ([[0.0, 1.0]], ("velocity", "acceleration")),
        "gyroscope": ([[1.0, 0.0]], ("angular rate", "angular acceleration")),
    }[sensor]
    return Component(
        drift=frozen([[0.0, 1.0], [0.0, 0.0]]),
        noise_input=frozen(np.eye(2)),
        noise_density=frozen(process_variance * np.eye(2)),
        output=frozen(reads),
        parts=(Part(sensor, names),),
    )


class Cost(NamedTuple):
    """What one filter costs by (10).

    Attributes
    ----------
    lag : float
        First integral, in unit^2 s.
    noise : float
        Second integral: in unit sqrt(Hz) of the amplitude spectrum, in unit^2 of the power spectrum.
    reached_after_s : float
        t_f - t_s, in seconds; NaN if the record ends before the output reaches the step.
    """

    lag: float
    noise: float
    reached_after_s: float

    @property
    def total(self) -> float:
        """J, the sum of both as numbers; their units differ, so that the unit of the record matters."""
        return self.lag + self.noise


@dataclass(frozen=True, eq=False)
class StepTrial:
    """A motionless record, and the step that is added to it.

    Attributes
    ----------
    record : (N,) float array
        Motionless readings, in unit, none missing; their mean is taken away.
    rate_hz : float
        Readings per second.
    sensor : {"accelerometer", "gyroscope"}
        Which model filters it; see `imu_component`.
    spectrum : {"amplitude", "power"}
        What |X(f)| means: the square root of the Welch power density, which the printed optimum
        needs, or that density itself.
    step : float
        S, in unit.
    step_at_s : float
        t_s, in seconds.
    initial_covariance : (2, 2) float array or None
        P0, about a state of zero; the paper has ones. None starts from the first readings.

    Raises
    ------
    RecordingError
        If readings are missing, the record is shorter than a segment or ends before the step, or the
        rate, step or spectrum is none.
    """

    record: Floats
    rate_hz: float
    sensor: Sensor
    spectrum: SpectrumKind = "amplitude"
    step: float = 0.2
    step_at_s: float = 5.0
    initial_covariance: Floats | None = None

    def __post_init__(self) -> None:
        """Check what came."""
        if self.record.ndim != 1 or len(self.record) < SEGMENT or not np.isfinite(self.record).all():
            raise RecordingError(f"A record of one channel is needed, (N,), {SEGMENT} readings or more, none missing.")
        if not (0 < self.rate_hz < np.inf and 0 < self.step < np.inf):
            raise RecordingError(f"rate_hz = {self.rate_hz} and step = {self.step}; both must be positive.")
        if not 0 <= self.step_at_s * self.rate_hz < len(self.record) - 1:
            lasts = len(self.record) / self.rate_hz
            raise RecordingError(
                f"The step at {self.step_at_s:g} s is not in the record of {lasts:g} s; set step_at_s."
            )
        if self.spectrum not in ("amplitude", "power"):
            raise RecordingError(f"spectrum = {self.spectrum!r} is not known; use 'amplitude' or 'power'.")
        imu_component(self.sensor, 1.0)

    def model(self, noise_variance: float, process_variance: float) -> Model:
        """Return the filter's model for R and Q, by an Euler step as in the paper."""
        euler = imu_component(self.sensor, process_variance).to_model(1 / self.rate_hz, noise_variance, "euler")
        if self.initial_covariance is None:
            return euler
        return Model(euler.F, euler.H, euler.Q, euler.R, euler.G, np.zeros(2), self.initial_covariance)

    def cost(self, noise_variance: float, process_variance: float) -> Cost:
        """Return what the filter of R and Q costs, both in unit^2; R = 0 needs an initial covariance.

        Notes
        -----
        The filter is linear in its readings: its output for record and step together is the sum of those
        for each. Nothing is approximated; the gain is the one that the recursion has at each reading.
        """
        model = self.model(noise_variance, process_variance)
        calm, stepped = (_filtered(model, z) for z in (self._centred, self._step))
        error = (self.step - calm - stepped)[self._first :]
        reached = np.flatnonzero(error <= 0)
        last = int(reached[0]) if len(reached) else len(error) - 1
        lag = float(np.trapezoid(error[: last + 1] ** 2, dx=1 / self.rate_hz))
        return Cost(lag, self._noise(calm), last / self.rate_hz if len(reached) else np.nan)

    def _noise(self, calm: Floats) -> float:
        """Return the integral of the spectrum of an output (N,)."""
        density = 2 * welch_power(calm, np.hanning(SEGMENT + 1)[:-1]) / self.rate_hz
        density[[0, -1]] /= 2  # neither has a mirrored frequency
        size = np.sqrt(density) if self.spectrum == "amplitude" else density
        return float(np.trapezoid(size, dx=self.rate_hz / SEGMENT))

    @cached_property
    def _first(self) -> int:
        """Row of the step."""
        return int(np.ceil(self.step_at_s * self.rate_hz - 1e-9))

    @cached_property
    def _centred(self) -> Floats:
        return np.asarray(self.record - self.record.mean())

    @cached_property
    def _step(self) -> Floats:
        return np.where(np.arange(len(self.record)) >= self._first, self.step, 0.0)


def _filtered(model: Model, z: Floats) -> Floats:
    """Return the causal output (N,) for readings (N,)."""
    return kalman_filter(model, z, sigma=False, innovations=False).signal[:, 0]
