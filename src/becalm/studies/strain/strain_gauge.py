"""Apply the strain paper's filter and becalm's filters to a real gauge on a bridge, and judge each filter."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from becalm.cleaning.channels.judging import InnovationJudge, Judgement
from becalm.cleaning.pipeline import clean
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.recording import Recording
from becalm.files.inputs.opening import read
from becalm.identification.at_rest.detection import detect_rests
from becalm.identification.at_rest.rest_noise import split_at_cutoff
from becalm.studies.strain.strain_methods import G_BY_TRIAL
from becalm.studies.strain.strain_model import Noise, likeliest, strain_model

AT_REST = "munich_bridge/reference_state_strain.csv.gz"
LOADED = "munich_bridge/support_load_strain.csv.gz"
CUTOFF_HZ = 1.0
"""Frequency below which variation at rest counts as drift."""

DRIFT_S = 10.0
"""Time over which residuals are averaged to show drift."""


class QuietStretch(NamedTuple):
    """The quiet stretch of another record in which R is measured."""

    begin_s: float
    end_s: float
    std: float  # standard deviation of the readings, in unit; the paper's R is its square
    noise_std: float  # standard deviation of the part above `CUTOFF_HZ`, in unit
    drift_std: float  # standard deviation of the part below `CUTOFF_HZ`, in unit

    @property
    def moved_share(self) -> float:
        """Return the share of the variance that is drift."""
        return self.drift_std**2 / (self.drift_std**2 + self.noise_std**2)


class Trial(NamedTuple):
    """The results of one filter on the loaded record."""

    jerk_variance: float  # G of the paper's filter, in unit^2/s^6; NaN for becalm's filters
    noise_std: float  # root of R, in unit
    tones_hz: tuple[float, ...]  # vibrations that becalm's filter counts as signal; empty for other filters
    output: Floats  # (N,) in unit
    judgement: Judgement
    residual_std: float  # standard deviation of readings minus output, in unit
    residual_drift: float  # largest magnitude of readings minus output, averaged over ten seconds, in unit


class Gauge(NamedTuple):
    """The results for a real gauge."""

    unit: str
    rate_hz: float
    rest: QuietStretch
    time_s: Floats  # (N,)
    readings: Floats  # (N,) loaded, in unit
    trials: dict[str, Trial]  # by filter


def missing_recordings(recordings: Path) -> str:
    """Return a sentence that names the missing recordings; empty if none is missing."""
    missing = [name for name in (AT_REST, LOADED) if not (recordings / name).exists()]
    return f"The real gauge is left out: {' and '.join(missing)} are not on this machine." if missing else ""


def measure_gauge(recordings: Path) -> Gauge:
    """Measure R at rest, filter the record of the loaded bridge, and judge every filter by its innovations."""
    rest = measure_rest(read(recordings / AT_REST))
    loaded = read(recordings / LOADED)
    loaded = loaded.select(loaded.names[:1])
    z, step_s = loaded.channel(loaded.names[0]), loaded.timebase.step_s
    given = rest.std**2
    noises = {
        "G of the simulation, R at rest": Noise(G_BY_TRIAL, given),
        "G by likelihood, R at rest": likeliest(z, step_s, given),
        "G by likelihood, R above 1 Hz": likeliest(z, step_s, rest.noise_std**2),
        "G and R by likelihood": likeliest(z, step_s),
    }
    trials = {name: _paper(noise, z, step_s) for name, noise in noises.items()}
    trials |= {f"becalm, {mode}": _becalm(loaded, mode == "causal") for mode in ("causal", "smoothed")}
    return Gauge(loaded.units[0], loaded.rate_hz, rest, loaded.timebase.elapsed_steps.cumsum() * step_s, z, trials)


def measure_rest(recording: Recording) -> QuietStretch:
    """Measure the noise of a recording's first channel in its longest quiet stretch."""
    first = recording.select(recording.names[:1])
    begin, end = max(detect_rests(first).stretches, key=lambda stretch: stretch.stop - stretch.start)
    quiet = first.channel(first.names[0])[begin:end]
    above, below = split_at_cutoff(quiet, first.rate_hz, CUTOFF_HZ)
    step_s = first.timebase.step_s
    return QuietStretch(begin * step_s, end * step_s, float(quiet.std()), float(np.sqrt(above)), float(np.sqrt(below)))


def _paper(noise: Noise, z: Floats, step_s: float) -> Trial:
    estimate, judge = kalman_filter(strain_model(noise, step_s), z), InnovationJudge(step_s)
    finite = np.isfinite(estimate.innovations[:, 0])
    judge.add(estimate.innovations[finite, 0], estimate.innovation_sigma[finite, 0])
    return _trial(noise, z, estimate.signal[:, 0], judge.judgement(), step_s)


def _becalm(loaded: Recording, causal: bool) -> Trial:
    cleaned, name = clean(loaded, causal=causal), loaded.names[0]
    report = cleaned.reports[0]
    noise = Noise(np.nan, np.nan if report.noise_std is None else report.noise_std**2)
    tried = _trial(noise, loaded.channel(name), cleaned.signal.channel(name), report, loaded.timebase.step_s)
    return tried._replace(tones_hz=report.tones_hz)


def _trial(noise: Noise, z: Floats, output: Floats, judgement: Judgement, step_s: float) -> Trial:
    residual, length = z - output, round(DRIFT_S / step_s)
    means = residual[: len(residual) // length * length].reshape(-1, length).mean(axis=1)
    drift = float(np.nanmax(np.abs(means)))
    std = float(np.sqrt(noise.noise_variance))
    return Trial(noise.jerk_variance, std, (), output, judgement, float(np.nanstd(residual)), drift)
