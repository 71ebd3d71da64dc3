"""Repeat the strain paper: ramps of quasi-static strain at 10 Hz, and a real gauge on a bridge.

A Kalman filter whose model has a random third derivative is compared with a Butterworth low-pass and with software
averaging. The paper finds the process noise variance G by trial and measures R beforehand; here both are identified
from the readings.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.metrics.delay import lag_of
from becalm.studies.recordings import RECORDINGS
from becalm.studies.strain.strain_gauge import Gauge, measure_gauge, missing_recordings
from becalm.studies.strain.strain_methods import METHODS, STEP_S, MethodOutcome, Records

NOISES = (0.02, 0.05, 0.1)  # standard deviations of the noise; the strain rises from 0 to 1
SHOWN = 0.05
"""Standard deviation of the noise of the record in the figures."""

RUNS = 20  # records for each noise
DURATION_S = 100.0
KNOTS_S, KNOTS = (0.0, 20.0, 40.0, 60.0, 80.0, 100.0), (0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
SLOPE = 0.05  # slope of the ramps, in unit/s

_SETTLED_S = ((30.0, 40.0), (70.0, 80.0))  # second halves of the ramps, in which the filters have settled


class FilterQuality(NamedTuple):
    """The quality of a filter, over all runs.

    Attributes
    ----------
    rms, rms_error : float
        Mean of the runs' rms errors, and the standard error of this mean, in unit.
    noise_share : float
        Share of the mean square error that differs between runs; the error due to lag and overshoot is equal in all.
    ramp_lag_s : float
        Lag of the output for the noiseless signal in the second halves of the ramps.
    record_lag_s : float
        Delay of the output for the noiseless signal at which it differs least from the signal over the whole record.
    overshoot : float
        Largest amount by which the output for the noiseless signal exceeds the range from 0 to 1.
    identified : tuple of (float, float, float)
        Medians of the identified process noise, standard deviation of the noise, and kinematic order; NaN if not
        identified.
    """

    rms: float
    rms_error: float
    noise_share: float
    ramp_lag_s: float
    record_lag_s: float
    overshoot: float
    identified: tuple[float, float, float]


class ShownRecord(NamedTuple):
    """One simulated record for the figures."""

    time_s: Floats
    truth: Floats
    outputs: dict[str, Floats]  # by method


class StrainStudy(NamedTuple):
    """All results of the study."""

    quality: dict[str, dict[float, FilterQuality]]  # by method and by standard deviation of the noise
    shown: ShownRecord
    gauge: Gauge | None
    why_no_gauge: str  # sentence on why there is no gauge; "" if there is one


def ramps() -> tuple[Floats, Floats]:
    """Return times (N,), in seconds, and the strain (N,) of the paper's simulation: zero, rise, hold, fall, zero."""
    time_s: Floats = np.arange(round(DURATION_S / STEP_S), dtype=np.float64) * STEP_S
    return time_s, np.asarray(np.interp(time_s, KNOTS_S, KNOTS), dtype=np.float64)


def records(noise_std: float, runs: int = RUNS) -> Records:
    """Return noisy readings of the ramps; the seed of run k is k."""
    _, truth = ramps()
    noise = np.column_stack([np.random.default_rng(run).normal(0.0, noise_std, len(truth)) for run in range(runs)])
    return Records(truth, truth[:, np.newaxis] + noise, noise_std)


def simulate(runs: int = RUNS) -> tuple[dict[str, dict[float, FilterQuality]], ShownRecord]:
    """Filter the simulated records by every method.

    Parameters
    ----------
    runs : int
        Number of records for each noise, at least two; a *small* number makes the means less certain.
    """
    measured: dict[str, dict[float, FilterQuality]] = {name: {} for name in METHODS}
    outputs: dict[str, Floats] = {}
    for noise_std in NOISES:
        noisy = records(noise_std, runs)
        for name, method in METHODS.items():
            outcome = method(noisy)
            measured[name][noise_std] = assess(outcome, noisy.truth)
            if noise_std == SHOWN:
                outputs[name] = outcome.outputs[:, 0]
    return measured, ShownRecord(*ramps(), outputs)


def assess(outcome: MethodOutcome, truth: Floats) -> FilterQuality:
    """Measure the errors of a filter on records of one signal (N,), the ramps."""
    time_s, _ = ramps()
    errors = outcome.outputs - truth[:, np.newaxis]
    rms = np.sqrt(np.mean(errors**2, axis=0))
    lag_s = (outcome.followed - truth[:, np.newaxis]) / -SLOPE
    (rise, fall) = ((time_s >= begin) & (time_s < end) for begin, end in _SETTLED_S)
    process, noise, order = np.median(outcome.identified, axis=0)
    followed = outcome.followed.T
    return FilterQuality(
        rms=float(rms.mean()),
        rms_error=float(rms.std(ddof=1) / np.sqrt(len(rms))),
        noise_share=min(float(np.mean(np.var(errors, axis=1, ddof=1)) / np.mean(errors**2)), 1.0),
        ramp_lag_s=float((lag_s[rise].mean() - lag_s[fall].mean()) / 2),
        record_lag_s=STEP_S * float(np.mean([lag_of(output, truth) for output in followed])),
        overshoot=float(np.mean([max(output.max() - 1, -output.min(), 0.0) for output in followed])),
        identified=(float(process), float(noise), float(order)),
    )


def study(runs: int = RUNS, recordings: Path = RECORDINGS) -> StrainStudy:
    """Repeat the paper's simulation, and analyse a real gauge if its recordings are present."""
    measured, shown = simulate(runs)
    why = missing_recordings(recordings)
    return StrainStudy(measured, shown, None if why else measure_gauge(recordings), why)
