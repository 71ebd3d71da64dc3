"""Compute the tuning cost of the IMU paper, which weighs lag against remaining noise.

J(R, Q) = int from t_s to t_f of (S - x)^2 dt + int from 0 to Fs/2 of |X(f)| df   (10)

In the first term x is the filter's output for a motionless record plus a step of S at t_s, and t_f is the first time at
which x reaches S. In the second term X is the Welch spectrum of the output for the record alone. Source: Kownacki
(2010). `becalm.identification.several.step_tuning` searches for the minimum.
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
"""Number of readings in a segment of the Welch spectrum."""


def imu_component(sensor: Sensor, process_variance: float) -> Component:
    """Return the paper's model of an accelerometer or a gyroscope.

    Parameters
    ----------
    sensor : {"accelerometer", "gyroscope"}
        The accelerometer has the state [V, a] and measures a; V is unobservable. The gyroscope has the state [omega,
        epsilon] and measures omega.
    process_variance : float
        Q, the variance of the noise on both states, in unit^2; an Euler step of T adds the covariance T^2 Q I. A
        *small* one trusts the model and smooths more.

    Raises
    ------
    ModelError
        If the sensor is not one of the two.
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
    """The cost of one filter by (10).

    Attributes
    ----------
    lag : float
        First integral of (10), in unit^2 s.
    noise : float
        Second integral of (10): in unit sqrt(Hz) for the amplitude spectrum, in unit^2 for the power spectrum.
    reached_after_s : float
        t_f - t_s, in seconds; NaN if the record ends before the output reaches the step.
    """

    lag: float
    noise: float
    reached_after_s: float

    @property
    def total(self) -> float:
        """Return J, the sum of both integrals; their units differ, so it depends on the unit of the record."""
        return self.lag + self.noise


@dataclass(frozen=True, eq=False)
class StepTrial:
    """A motionless record and a step that is added to it, for which filters are compared.

    Attributes
    ----------
    record : (N,) float array
        Motionless readings in unit, none missing; their mean is subtracted.
    rate_hz : float
        Readings per second.
    sensor : {"accelerometer", "gyroscope"}
        The sensor, which determines the filter's model; see `imu_component`.
    spectrum : {"amplitude", "power"}
        Meaning of |X(f)|: the square root of the Welch power density, which gives the optimum that the paper prints, or
        that density itself.
    step : float
        S, in unit.
    step_at_s : float
        t_s, in seconds.
    initial_covariance : (2, 2) float array or None
        P0 around a state of zero; the paper uses ones. With None the first readings determine the state.

    Raises
    ------
    RecordingError
        If readings are missing, the record is shorter than a segment or ends before the step, or the rate, the step or
        the spectrum is invalid.
    ModelError
        If the sensor is not one of the two.
    """

    record: Floats
    rate_hz: float
    sensor: Sensor
    spectrum: SpectrumKind = "amplitude"
    step: float = 0.2
    step_at_s: float = 5.0
    initial_covariance: Floats | None = None

    def __post_init__(self) -> None:
        """Check the record, the step and the names."""
        if self.record.ndim != 1 or len(self.record) < SEGMENT or not np.isfinite(self.record).all():
            raise RecordingError(
                f"The record must have one channel, (N,), with {SEGMENT} readings or more, none missing."
            )
        if not (0 < self.rate_hz < np.inf and 0 < self.step < np.inf):
            raise RecordingError(f"rate_hz = {self.rate_hz} and step = {self.step}; both must be positive.")
        if not 0 <= self.step_at_s * self.rate_hz < len(self.record) - 1:
            lasts = len(self.record) / self.rate_hz
            raise RecordingError(
                f"The step at {self.step_at_s:g} s is not within the record of {lasts:g} s; set step_at_s."
            )
        if self.spectrum not in ("amplitude", "power"):
            raise RecordingError(f"spectrum = {self.spectrum!r} is not known; use 'amplitude' or 'power'.")
        imu_component(self.sensor, 1.0)

    def model(self, noise_variance: float, process_variance: float) -> Model:
        """Return the filter's model for R and Q, discretised by an Euler step as in the paper."""
        euler = imu_component(self.sensor, process_variance).to_model(1 / self.rate_hz, noise_variance, "euler")
        if self.initial_covariance is None:
            return euler
        return Model(euler.F, euler.H, euler.Q, euler.R, euler.G, np.zeros(2), self.initial_covariance)

    def cost(self, noise_variance: float, process_variance: float) -> Cost:
        """Return the cost of the filter with R and Q, both in unit^2; R = 0 needs an initial covariance.

        Notes
        -----
        The filter is linear in its readings, so its output for record plus step is the sum of its outputs for both.
        Nothing is approximated: the gain at each reading is that of the recursion.
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
        density[[0, -1]] /= 2  # 0 Hz and half the rate have no mirrored frequency
        size = np.sqrt(density) if self.spectrum == "amplitude" else density
        return float(np.trapezoid(size, dx=self.rate_hz / SEGMENT))

    @cached_property
    def _first(self) -> int:
        """Return the row at which the step starts."""
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
