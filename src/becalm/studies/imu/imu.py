"""Repeat the IMU paper (Kownacki 2010): R and Q of a motionless record give slow filters; find better R and Q.

`study` computes the results, `becalm.studies.imu.imu_figures` describes the figures, and `becalm.studies.imu.imu_page`
writes the page.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from becalm.core.arrays import Floats
from becalm.identification.several.step_spectrum import Sensor
from becalm.metrics.spectrum import Spectrum, welch
from becalm.studies.imu.imu_records import (
    PRINTED,
    RATE_HZ,
    RECORD_S,
    RECORDS,
    SENSORS,
    Identified,
    Rest,
    find_rests,
    identify,
    motionless,
)
from becalm.studies.imu.imu_responses import FilterResponse, NoiseSetting, compute_response, compute_responses
from becalm.studies.imu.imu_switching import ImmComparison, compare_imm
from becalm.studies.imu.imu_valley import ColouredRecord, Optimum, optimise, tune_coloured_records
from becalm.studies.recordings import RECORDINGS

_FINE = 8192  # samples in a segment of Welch's method


@dataclass(frozen=True, eq=False)
class SensorStudy:
    """The results for one sensor of the paper.

    Attributes
    ----------
    record : (N,) float array
        Simulated motionless record of ten seconds, in unit: figure 3.
    spectrum : Spectrum
        Spectrum of the record: figure 4.
    identified : tuple of Identified
        Table 1, one entry for each simulated record of two minutes.
    responses : tuple of FilterResponse
        Responses in the panels of figure 5 or 6.
    optimum : Optimum
        Table 2 and figure 8.
    tuned : tuple of FilterResponse
        Figure 9: responses at the paper's optimum, and at the optimum computed here.
    """

    record: Floats
    spectrum: Spectrum
    identified: tuple[Identified, ...]
    responses: tuple[FilterResponse, ...]
    optimum: Optimum
    tuned: tuple[FilterResponse, ...]


@dataclass(frozen=True, eq=False)
class Study:
    """All results of the study.

    Attributes
    ----------
    sensors : dict of SensorStudy
        Results for each sensor, by name.
    coloured_records : tuple of ColouredRecord
        Records that may explain the accelerometer's printed optimum.
    rests : tuple of Rest
        Rests in real recordings.
    skipped : tuple of str
        A sentence for each real recording that is left out.
    comparison : ImmComparison
        Comparison of an IMM with the paper's optimum.
    """

    sensors: dict[Sensor, SensorStudy]
    coloured_records: tuple[ColouredRecord, ...]
    rests: tuple[Rest, ...]
    skipped: tuple[str, ...]
    comparison: ImmComparison


def study(recordings: Path = RECORDINGS) -> Study:
    """Compute all results; real recordings are read from a folder, and missing recordings are left out."""
    rests, skipped = find_rests(recordings)
    return Study(
        {sensor: study_sensor(sensor) for sensor in SENSORS}, tune_coloured_records(), rests, skipped, compare_imm()
    )


def study_sensor(sensor: Sensor) -> SensorStudy:
    """Compute the results for one sensor."""
    record, printed = motionless(sensor, 0), PRINTED[sensor]
    identified = tuple(identify(motionless(sensor, seed, RECORD_S), RATE_HZ) for seed in RECORDS)
    optimum = optimise(sensor)
    own = NoiseSetting("here", printed.measured_noise, optimum.ratio * printed.measured_noise)
    paper = NoiseSetting("paper", printed.tuned_noise, printed.tuned_process)
    tuned = tuple(compute_response(sensor, record, setting) for setting in (paper, own))
    shown = welch(np.asarray(record - record.mean()), RATE_HZ, _FINE)
    return SensorStudy(record, shown, identified, compute_responses(sensor, record), optimum, tuned)
