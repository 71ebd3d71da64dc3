"""Minimise the cost of the IMU paper (figure 8, table 2): over R and Q it is a valley, and only Q/R is determined."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.identification.several.step_spectrum import Sensor, StepTrial
from becalm.identification.several.step_tuning import StepTuning, tune_by_simplex, tune_by_step
from becalm.studies.imu.imu_records import PRINTED, RATE_HZ, harmonics, motionless, noise_parts, white
from becalm.studies.imu.imu_responses import reached_ms

SEEDS = range(5)  # seeds of the records of white noise
STARTS = ((1e-3, 1.0), (1.0, 1e-3))
"""Starting points (R, Q), in unit^2, of the search over R and Q, in addition to R and Q of table 1."""

_DECADES = np.arange(-13.0, 2.0)  # log10 R on the surface
_RAISED = 2  # decades by which the grid of Q begins above that of R
_BELOW_HZ = (5.0, 500.0)  # band that begins below the harmonics
_SHOWN_HZ = (50.0, 500.0)  # band of the harmonics that the paper shows


class ValleySurface(NamedTuple):
    """The cost over decades of R and Q.

    Attributes
    ----------
    log_noise, log_process : (k,) float array
        Base-10 logarithms of R, and of Q.
    cost : (k, k) float array
        Cost J; rows are R, columns are Q.
    """

    log_noise: Floats
    log_process: Floats
    cost: Floats

    @property
    def floor_decade(self) -> int:
        """Return the integer log10(Q/R) at which the average cost is least."""
        offsets = range(-len(self.cost) + 3, len(self.cost) - 2)
        return _RAISED + min(offsets, key=lambda offset: float(np.mean(np.diagonal(self.cost, offset))))

    @property
    def unevenness(self) -> float:
        """Return the relative variation of the cost along its floor: (maximum - minimum) / minimum."""
        floor = np.diagonal(self.cost, self.floor_decade - _RAISED)
        return float((floor.max() - floor.min()) / floor.min())


class Optimum(NamedTuple):
    """The minima of the cost for one sensor, on white noise of table 1's variance.

    Attributes
    ----------
    ratios : (k,) float array
        Q/R of least cost for each record.
    excess : float
        J at the paper's ratio relative to the least J, median over the records.
    ends : tuple of StepTuning
        Results of the search over Q/R, and then of the searches over R and Q, all on the first record.
    reached_ms, paper_reached_ms : float
        Time to nine tenths of a step at the median ratio, and at the paper's ratio.
    surface : ValleySurface
        Cost over R and Q for the first record.
    """

    ratios: Floats
    excess: float
    ends: tuple[StepTuning, ...]
    reached_ms: float
    paper_reached_ms: float
    surface: ValleySurface

    @property
    def ratio(self) -> float:
        """Return the median of the Q/R of least cost."""
        return float(np.median(self.ratios))


class ColouredRecord(NamedTuple):
    """The composition of a record, and its Q/R of least cost."""

    made_of: str
    ratio: float


def optimise(sensor: Sensor) -> Optimum:
    """Minimise the cost for records of white noise, both over Q/R alone and over R and Q."""
    printed = PRINTED[sensor]
    trials = [StepTrial(white(sensor, seed), RATE_HZ, sensor) for seed in SEEDS]
    tunings = [tune_by_step(trial, printed.measured_noise) for trial in trials]
    at_printed = [trial.cost(printed.measured_noise, printed.ratio * printed.measured_noise).total for trial in trials]
    excess = np.median([cost / each.cost.total for cost, each in zip(at_printed, tunings, strict=True)])
    starts = ((printed.measured_noise, printed.measured_process), *STARTS)
    ends = (tunings[0], *(tune_by_simplex(trials[0], *start) for start in starts))
    ratios = np.array([each.ratio for each in tunings])
    own_ms, paper_ms = reached_ms(sensor, float(np.median(ratios))), reached_ms(sensor, printed.ratio)
    return Optimum(ratios, float(excess), ends, own_ms, paper_ms, _surface(trials[0]))


def _surface(trial: StepTrial) -> ValleySurface:
    raised = _DECADES + _RAISED
    cost = np.array([[trial.cost(noise, process).total for process in 10.0**raised] for noise in 10.0**_DECADES])
    return ValleySurface(_DECADES, raised, cost)


def tune_coloured_records() -> tuple[ColouredRecord, ...]:
    """Find Q/R for the accelerometer on records of equal variance and different spectra, to explain the printed Q/R."""
    sensor: Sensor = "accelerometer"
    variance, rng = PRINTED[sensor].measured_noise, np.random.default_rng(0)
    share = noise_parts(PRINTED[sensor]).harmonic / variance
    half = np.sqrt(variance / 2) * (rng.normal(size=100_000) + harmonics(100_000, rng))
    made: dict[str, Callable[[], Floats]] = {
        "white": lambda: white(sensor, 0),
        "half white, half in equal harmonics of 50 to 500 Hz": lambda: half,
        f"{share:.0%} in equal harmonics, as in table 1": lambda: motionless(sensor, 0),
        "all at 50 to 500 Hz, density falling as 1/f^2": lambda: np.sqrt(variance) * _falling(*_SHOWN_HZ, rng),
        "all at 5 to 500 Hz, density falling as 1/f^2": lambda: np.sqrt(variance) * _falling(*_BELOW_HZ, rng),
    }
    return tuple(
        ColouredRecord(name, tune_by_step(StepTrial(record(), RATE_HZ, sensor), variance).ratio)
        for name, record in made.items()
    )


def least_ratio(low_hz: float = _SHOWN_HZ[0], high_hz: float = _SHOWN_HZ[1], step: float = 0.2) -> float:
    """Return approximately the smallest Q/R that is optimal for any noise in a band with the accelerometer's variance.

    Notes
    -----
    S is the height of the step (`step`), A(f) the amplitude density of the noise. For a low-pass with cut-off
    w = sqrt(Q/R), far below the band, J = S^2 / (2 w) + w / (2 pi) int A(f) / f df; its minimum is at
    w^2 = pi S^2 / int A / f df. By Cauchy-Schwarz the integral is at most sqrt(variance (1 / low - 1 / high)), with
    equality for A = c / f.
    """
    variance = PRINTED["accelerometer"].measured_noise
    return float(np.pi * step**2 / np.sqrt(variance * (1 / low_hz - 1 / high_hz)))


def _falling(low_hz: float, high_hz: float, rng: np.random.Generator) -> Floats:
    """Return ten seconds of noise in a band with variance 1 and a power density proportional to 1/f^2."""
    count = round(10 * RATE_HZ)
    f = np.fft.rfftfreq(count, 1 / RATE_HZ)
    inside = (f >= low_hz) & (f <= high_hz)
    drawn = rng.normal(size=len(f)) + 1j * rng.normal(size=len(f))
    noise = np.fft.irfft(np.where(inside, drawn / np.maximum(f, low_hz), 0.0), count)
    return np.asarray(noise / noise.std())
