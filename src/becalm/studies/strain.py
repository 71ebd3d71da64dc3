"""The strain paper re-run: a ramp, a hold and a ramp at 10 Hz, and a real gauge on a bridge.

Quasi-static strain by a Kalman filter whose third derivative is random, beside a Butterworth low-pass and software
averaging; what the paper found by trial, and measured beforehand, is told by the readings here.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.metrics.delay import lag_of
from becalm.studies.recordings import RECORDINGS
from becalm.studies.strain_gauge import Gauge, absent, measure_gauge
from becalm.studies.strain_methods import METHODS, STEP_S, MethodOutcome, Records

NOISES = (0.02, 0.05, 0.1)
SHOWN = 0.05
"""Noise of the record that figures show."""

RUNS = 20
DURATION_S = 100.0
KNOTS_S, KNOTS = (0.0, 20.0, 40.0, 60.0, 80.0, 100.0), (0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
SLOPE = 0.05  # of the ramps, in unit/s

_SETTLED_S = ((30.0, 40.0), (70.0, 80.0))  # halves of the ramps in which filters have settled


class Measured(NamedTuple):
    """How well a filter did, over all runs.

    Attributes
    ----------
    rms, rms_error : float
        Mean of the runs' rms errors, and the standard error of this mean, in unit.
    noise_share : float
        Of the mean square error, that differs from run to run; the rest is the same in all, lag and overshoot.
    ramp_lag_s : float
        How far the output of the noiseless signal trails it at the end of the ramps.
    record_lag_s : float
        By which delay that output and the signal differ least, over the whole record.
    overshoot : float
        How far that output goes beyond 0 and 1, over the height of 1.
    told : tuple of (float, float, float)
        Medians of what the records told: process noise, standard deviation of the noise, order of the motion; NaN
        where nothing.
    """

    rms: float
    rms_error: float
    noise_share: float
    ramp_lag_s: float
    record_lag_s: float
    overshoot: float
    told: tuple[float, float, float]


class ShownRecord(NamedTuple):
    """One record, for figures."""

    time_s: Floats
    truth: Floats
    outputs: dict[str, Floats]  # of each method


class StrainStudy(NamedTuple):
    """Everything that the page tells."""

    measured: dict[str, dict[float, Measured]]  # by method, by noise
    shown: ShownRecord
    gauge: Gauge | None
    absent: str  # why there is no gauge; "" where there is


def ramps() -> tuple[Floats, Floats]:
    """Return seconds (N,) and the strain of the paper's simulation (N,): zero, rise, hold, fall, zero."""
    time_s: Floats = np.arange(round(DURATION_S / STEP_S), dtype=np.float64) * STEP_S
    return time_s, np.asarray(np.interp(time_s, KNOTS_S, KNOTS), dtype=np.float64)


def records(noise_std: float, runs: int = RUNS) -> Records:
    """Return noisy readings of the ramps; run k is seeded by k."""
    _, truth = ramps()
    noise = np.column_stack([np.random.default_rng(run).normal(0.0, noise_std, len(truth)) for run in range(runs)])
    return Records(truth, truth[:, np.newaxis] + noise, noise_std)


def simulate(runs: int = RUNS) -> tuple[dict[str, dict[float, Measured]], ShownRecord]:
    """Filter the simulated records by every method.

    Parameters
    ----------
    runs : int
        Records of each noise; with a *small* number means are less certain. Two or more.
    """
    found: dict[str, dict[float, Measured]] = {name: {} for name in METHODS}
    outputs: dict[str, Floats] = {}
    for noise_std in NOISES:
        noisy = records(noise_std, runs)
        for name, method in METHODS.items():
            outcome = method(noisy)
            found[name][noise_std] = measure(outcome, noisy.truth)
            if noise_std == SHOWN:
                outputs[name] = outcome.outputs[:, 0]
    return found, ShownRecord(*ramps(), outputs)


def measure(outcome: MethodOutcome, truth: Floats) -> Measured:
    """Measure what a filter made of records of one signal (N,), the ramps."""
    time_s, _ = ramps()
    errors = outcome.outputs - truth[:, np.newaxis]
    rms = np.sqrt(np.mean(errors**2, axis=0))
    behind = (outcome.followed - truth[:, np.newaxis]) / -SLOPE
    (rise, fall) = ((time_s >= begin) & (time_s < end) for begin, end in _SETTLED_S)
    process, noise, order = np.median(outcome.told, axis=0)
    followed = outcome.followed.T
    return Measured(
        rms=float(rms.mean()),
        rms_error=float(rms.std(ddof=1) / np.sqrt(len(rms))),
        noise_share=min(float(np.mean(np.var(errors, axis=1, ddof=1)) / np.mean(errors**2)), 1.0),
        ramp_lag_s=float((behind[rise].mean() - behind[fall].mean()) / 2),
        record_lag_s=STEP_S * float(np.mean([lag_of(output, truth) for output in followed])),
        overshoot=float(np.mean([max(output.max() - 1, -output.min(), 0.0) for output in followed])),
        told=(float(process), float(noise), float(order)),
    )


def study(runs: int = RUNS, recordings: Path = RECORDINGS) -> StrainStudy:
    """Re-run the paper: its simulation, and a real gauge where its recordings are there."""
    measured, shown = simulate(runs)
    why = absent(recordings)
    return StrainStudy(measured, shown, None if why else measure_gauge(recordings), why)
