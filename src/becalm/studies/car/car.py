"""Repeat the car paper (Sensors 2001) with its filter, an RLS canceller and becalm: a simulated drive, a real car.

`car_drive` simulates the drive, `car_filters` has the paper's filter, and `car_real` uses recordings of a real car.
`car_page` and `car_figures` write the page and its figures from the result of `study`.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from becalm.classic.canceller import cancel
from becalm.cleaning.pipeline import clean
from becalm.cleaning.tuning import tune
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.model.model import Model
from becalm.core.recording import Recording
from becalm.core.steady.response import describe
from becalm.identification.several.joint import TunedModel, tune_model
from becalm.metrics.decibels import snr_db, snr_paper_db
from becalm.metrics.delay import lag_of
from becalm.metrics.spectrum import VEHICLE_BANDS_HZ, band_powers, welch
from becalm.metrics.truth import rms_error
from becalm.studies.car.car_drive import (
    BODY_HZ,
    INPUT_SNR_PAPER_DB,
    OTHER_SHARES,
    OUTPUT_SNR_PAPER_DB,
    CarDrive,
    simulate,
)
from becalm.studies.car.car_filters import (
    CHECKED_GAIN,
    FormDifferences,
    FrequencyLimits,
    T,
    compare_forms,
    computed_noise_gain,
    frequency_limits,
    measured_noise_gain,
    printed_model,
    settled_gain,
    vertical_alone,
)
from becalm.studies.car.car_real import RealCar, study_real_car
from becalm.studies.drive import RATE_HZ
from becalm.studies.recordings import RECORDINGS

AXES = ("a_x", "a_z")
MEASURED, TRUTH = "measured", "truth"
PRINTED, OWN = "paper's matrices", "becalm: three sensors"
PER_CHANNEL, PER_CHANNEL_DISTURBANCE = (
    "becalm: channel by channel",
    "becalm: channel by channel, vibration as disturbance",
)
CANCELLER = "RLS canceller"
REFERENCE_HZ = 5.0  # -3 dB cutoff of the high-pass that makes the canceller's reference

_SEGMENT = 4096  # samples in a segment of Welch's method: 0.12 Hz


class CarScore(NamedTuple):
    """The quality of one filter's output for one acceleration."""

    filter: str
    axis: str
    snr_db: float  # signal-to-noise ratio of the output, (14), in usual decibels
    snr_paper_db: float  # the same ratio in the paper's decibels, which are twice as many
    described_lag_s: float  # delay of a slow signal, computed from the model; only for a_z, NaN if unknown
    measured_lag_s: float  # by cross-correlation with the truth
    rms_error: float  # m/s^2


class ErrorParts(NamedTuple):
    """The parts of the mean square error of a filter's output for one acceleration, in (m/s^2)^2."""

    filter: str
    axis: str
    power_before: dict[str, float]  # of each kind of noise, before the filter
    power_after: dict[str, float]  # of each kind of noise, after the filter; "signal" is the distortion of the signal


class OtherShares(NamedTuple):
    """The rms errors along and up, in m/s^2, for a drive with other shares of the kinds of noise."""

    shares: dict[str, float]
    printed: tuple[float, float]  # with the paper's matrices
    own: tuple[float, float]  # with Q and R identified by likelihood


class CarStudy(NamedTuple):
    """All numbers and curves of the study; pairs and (2,) arrays hold one value along and one up."""

    drive: CarDrive
    input_snr_paper_db: tuple[float, float]
    estimates: dict[str, Floats]  # (N, 3) speed, a_x, a_z, by filter; also `TRUTH` and `MEASURED`
    scores: tuple[CarScore, ...]
    error_parts: tuple[ErrorParts, ...]
    forms: FormDifferences
    gain: Floats  # (3, 3) steady-state gain with the paper's matrices
    gain_difference: float  # largest difference from `CHECKED_GAIN`
    noise_gain: Floats  # (2,) noise gain with the paper's matrices, computed
    noise_gain_measured: Floats  # (2,) noise gain with the paper's matrices, measured
    limits: tuple[FrequencyLimits, FrequencyLimits]
    bands: dict[str, tuple[dict[str, float], dict[str, float]]]  # by filter and axis: (m/s^2)^2 in each band
    own: TunedModel  # the paper's model with Q and R identified by likelihood
    others: tuple[OtherShares, ...]
    real: RealCar | None


def study(recordings: Path = RECORDINGS, *, seed: int = 1, channel_by_channel: bool = True) -> CarStudy:
    """Compute all numbers and curves of the study.

    Parameters
    ----------
    recordings : Path
        Folder of real recordings; without the recordings of the car, `real` is None.
    seed : int
        Seed of the simulated drive.
    channel_by_channel : bool
        Whether to clean also each channel separately, without any settings.
    """
    drive = simulate(seed)
    z, truth = drive.measured.samples, drive.truth.samples
    printed = printed_model()
    own = tune_model(printed_model(known_start=False), z)
    estimates = {TRUTH: truth, MEASURED: z, PRINTED: _filtered(printed, z), OWN: _filtered(own.model, z)}
    if channel_by_channel:
        estimates |= _clean_per_channel(drive.measured)
    estimates[CANCELLER] = np.column_stack([cancel(column, REFERENCE_HZ / RATE_HZ) for column in z.T])
    models, gain = {PRINTED: printed, OWN: own.model}, settled_gain(printed)
    printed_snr = tuple(zip(INPUT_SNR_PAPER_DB, OUTPUT_SNR_PAPER_DB, strict=True))
    along, up = (frequency_limits(printed, axis, *snr) for axis, snr in enumerate(printed_snr, start=1))
    return CarStudy(
        drive=drive,
        input_snr_paper_db=_input_ratios(drive),
        estimates=estimates,
        scores=tuple(
            _score(name, axis, estimates, models.get(name)) for axis in (1, 2) for name in _filters(estimates)
        ),
        error_parts=tuple(_error_parts(name, models[name], axis, drive) for axis in (1, 2) for name in models),
        forms=compare_forms(printed, z),
        gain=gain,
        gain_difference=float(np.abs(gain - CHECKED_GAIN).max()),
        noise_gain=computed_noise_gain(printed)[1:],
        noise_gain_measured=measured_noise_gain(printed)[1:],
        limits=(along, up),
        bands={name: _bands(values) for name, values in estimates.items()},
        own=own,
        others=tuple(_other(shares, seed) for shares in OTHER_SHARES),
        real=study_real_car(recordings),
    )


def _other(shares: dict[str, float], seed: int) -> OtherShares:
    drive = simulate(seed, shares)
    z, truth = drive.measured.samples, drive.truth.samples
    models = printed_model(), tune_model(printed_model(known_start=False), z).model
    printed, own = (
        (rms_error(s[:, 1], truth[:, 1]), rms_error(s[:, 2], truth[:, 2])) for s in (_filtered(m, z) for m in models)
    )
    return OtherShares(shares, printed, own)


def _filtered(model: Model, z: Floats) -> Floats:
    return kalman_filter(model, z, sigma=False, innovations=False).signal


def _clean_per_channel(measured: Recording) -> dict[str, Floats]:
    """Clean each channel separately: without settings, and with tones above the body's band set as disturbances."""
    recipe = tune(measured, causal=True)
    channels = []
    for channel in recipe.channel:
        tones = [tone.model_copy(update={"disturbance": tone.frequency_hz > BODY_HZ[1]}) for tone in channel.tone]
        channels.append(channel.model_copy(update={"tone": tuple(tones)}))
    disturbed = recipe.model_copy(update={"channel": tuple(channels)})
    return {
        PER_CHANNEL: clean(measured, recipe).signal.samples,
        PER_CHANNEL_DISTURBANCE: clean(measured, disturbed).signal.samples,
    }


def _filters(estimates: dict[str, Floats]) -> list[str]:
    return [name for name in estimates if name not in (TRUTH, MEASURED)]


def _input_ratios(drive: CarDrive) -> tuple[float, float]:
    """Return the input signal-to-noise ratios of the drive by (12), from the added noise, in the paper's dB."""
    signal, noise = drive.truth.samples[:, 1:], sum(drive.noise.values(), np.zeros(1))
    along, up = (snr_paper_db(signal[:, k], noise[:, k]) for k in (0, 1))
    return along, up


def _score(name: str, axis: int, estimates: dict[str, Floats], model: Model | None) -> CarScore:
    signal, truth = estimates[name][:, axis], estimates[TRUTH][:, axis]
    error = signal - truth
    described = describe(vertical_alone(model), T).dc_delay_s if model and axis == 2 else np.nan
    return CarScore(
        name,
        AXES[axis - 1],
        snr_db(signal, error),
        snr_paper_db(signal, error),
        described,
        lag_of(signal, truth) * T,
        rms_error(signal, truth),
    )


def _error_parts(name: str, model: Model, axis: int, drive: CarDrive) -> ErrorParts:
    """Filter each kind of noise and the signal separately; the filter is linear, so their outputs sum to its output."""

    def output(values: Floats) -> Floats:
        return _filtered(model, values)[:, axis]

    truth = drive.truth.samples
    still = np.zeros(len(truth))
    kinds = {kind: np.column_stack([still, noise]) for kind, noise in drive.noise.items()}
    kinds["speed's"] = np.column_stack([drive.measured.samples[:, 0] - truth[:, 0], still, still])
    after = {kind: float(np.mean(output(noise) ** 2)) for kind, noise in kinds.items()}
    after["signal"] = float(np.mean((output(truth) - truth[:, axis]) ** 2))
    before = {kind: float(np.mean(noise[:, axis] ** 2)) for kind, noise in kinds.items()}
    return ErrorParts(name, AXES[axis - 1], before, after)


def _bands(samples: Floats) -> tuple[dict[str, float], dict[str, float]]:
    """Return the power of both accelerations in the vehicle's bands, over the rows in which all values are finite."""
    finite = samples[np.isfinite(samples).all(axis=1)]
    along, up = (band_powers(welch(finite[:, axis], RATE_HZ, _SEGMENT), VEHICLE_BANDS_HZ) for axis in (1, 2))
    return along, up
