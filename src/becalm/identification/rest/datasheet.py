"""Datasheet numbers to R and q, and back.

Two densities of the same white noise go by the same unit. A *noise density* n_d, in ug/sqrt(Hz) or
(deg/s)/sqrt(Hz), is one-sided: its square fills the band from 0 to half of the rate. An *angle* or
*velocity random walk* N, in deg/sqrt(h) or (m/s)/sqrt(h), is two-sided, and what an Allan deviation
reads: N = n_d / sqrt(2). The variance of one reading is R = N^2 rate = n_d^2 rate / 2.

The unit says which of the two is meant: per root of hertz one-sided, per root of time two-sided.
Where a sheet states in words that its density is two-sided, its words hold: `convert` gives N then.
The table of units (`datasheet_units`) is closed. Source: IEEE Std 952-1997, annex C.
"""

from __future__ import annotations

import numpy as np

from becalm.errors import UsageError
from becalm.identification.rest.datasheet_units import reading_size, walk_size, white_size


def convert(value: float, unit: str, reading_unit: str) -> float:
    """Return a bias, a step or another reading in another unit.

    Parameters
    ----------
    value : float
        In `unit`.
    unit, reading_unit : str
        m/s^2, g, mg, ug; rad/s, deg/s, mdeg/s, deg/h; m/m, um/m, nm/m.

    Raises
    ------
    UsageError
        If a unit is not in the table, or the two measure different things.
    """
    return _checked("value", value, bool(np.isfinite(value)), "a number") * reading_size(unit, reading_unit)


def white_noise(value: float, unit: str, reading_unit: str) -> float:
    """Return N, two-sided, in reading_unit s^(1/2), of white noise as a datasheet gives it.

    Parameters
    ----------
    value : float
        In `unit`.
    unit : str
        One-sided per sqrt(Hz), as "ug/sqrt(Hz)", "(deg/s)/sqrt(Hz)", "um/m/sqrt(Hz)"; or two-sided of
        the sum, as "deg/sqrt(h)", "(m/s)/sqrt(h)".
    reading_unit : str
        Unit of the readings to be filtered, as "m/s^2".

    Raises
    ------
    UsageError
        If the unit is not one of white noise, or measures something else.
    """
    return _finite(value) * white_size(unit, reading_unit)


def white_noise_in(unit: str, white: float, reading_unit: str) -> float:
    """Return white noise as a datasheet would give it: the inverse of `white_noise`.

    Parameters
    ----------
    unit : str
        Of what is returned, as "ug/sqrt(Hz)" or "deg/sqrt(h)".
    white : float
        N, two-sided, in reading_unit s^(1/2).
    reading_unit : str
        Unit of the readings, as "m/s^2".

    Raises
    ------
    UsageError
        If the unit is not one of white noise, or measures something else.
    """
    return _finite(white) / white_size(unit, reading_unit)


def random_walk(value: float, unit: str, reading_unit: str) -> float:
    """Return K, in reading_unit / s^(1/2), of a rate random walk as a datasheet gives it.

    Its square is the `noise_density` of `components.level`.

    Parameters
    ----------
    value : float
        In `unit`.
    unit : str
        Of the reading per root of time, as "deg/s/sqrt(h)", "deg/h/sqrt(h)", "ug/sqrt(s)".
    reading_unit : str
        Unit of the readings to be filtered, as "deg/s".

    Raises
    ------
    UsageError
        If the unit is not one of a random walk, or measures something else.
    """
    return _finite(value) * walk_size(unit, reading_unit)


def random_walk_in(unit: str, walk: float, reading_unit: str) -> float:
    """Return a rate random walk as a datasheet would give it: the inverse of `random_walk`.

    Parameters
    ----------
    unit : str
        Of what is returned, as "deg/h/sqrt(h)" or "ug/sqrt(s)".
    walk : float
        K, in reading_unit / s^(1/2).
    reading_unit : str
        Unit of the readings, as "deg/s".

    Raises
    ------
    UsageError
        If the unit is not one of a random walk, or measures something else.
    """
    return _finite(walk) / walk_size(unit, reading_unit)


def random_walk_of_stability(lowest_deviation: float, white: float) -> float:
    """Return K, in unit / s^(1/2), from an in-run bias stability, the lowest point of the Allan deviation.

    Parameters
    ----------
    lowest_deviation : float
        In the unit of the readings; a *small* one trusts the bias and follows it slowly.
    white : float
        N, in unit s^(1/2).

    Notes
    -----
    White noise and a random walk alone have their lowest point at tau = sqrt(3) N / K, where
    sigma^2 = 2 N K / sqrt(3). Where a flat stretch lies between, K is at most this.
    """
    return float(np.sqrt(3) / 2 * _positive("lowest_deviation", lowest_deviation) ** 2 / _positive("white", white))


def noise_variance(white: float, rate_hz: float, bandwidth_hz: float = np.inf, poles: int = 1) -> float:
    """Return R, the variance of one reading's white noise, in unit^2.

    Parameters
    ----------
    white : float
        N, two-sided, in unit s^(1/2), from `white_noise`.
    rate_hz : float
        Readings a second.
    bandwidth_hz : float
        Where the sensor's own low-pass is at -3 dB; inf for one that averages between two readings.
    poles : {1, 2}
        Of that low-pass; two are a Butterworth.

    Raises
    ------
    UsageError
        If a number is not positive, or there are other poles.

    Notes
    -----
    Noise over half of the rate is folded back. What a filter slower than the sensor meets is the folded
    density at low frequencies, R = N^2 rate times the sum of abs(H(k rate))^2 over k, here in closed form. It goes from
    N^2 rate, of a bandwidth far below the rate, where readings are correlated and their own variance
    `rms(...)^2` would promise too much, to 2 N^2 (noise bandwidth), of one far above it. A sensor
    that is read with its full bandwidth is noisier than n_d^2 rate / 2 says.
    """
    flat = _positive("white", white) ** 2 * _positive("rate_hz", rate_hz)
    _check_poles(poles)
    if bandwidth_hz == np.inf:
        return flat
    x = np.pi * _positive("bandwidth_hz", bandwidth_hz) / rate_hz
    if poles == 1:
        return float(flat * x / np.tanh(x))
    y = np.sqrt(2) * x
    fade = np.exp(-y)
    rise, fall = -np.expm1(-2 * y) + 2 * fade * np.sin(y), np.expm1(-y) ** 2 + 4 * fade * np.sin(y / 2) ** 2
    return float(flat * y / 2 * rise / fall)


def noise_bandwidth(bandwidth_hz: float, poles: int = 1) -> float:
    """Return the width, in Hz, of the ideal low-pass that passes as much white noise.

    Parameters
    ----------
    bandwidth_hz : float
        Where the low-pass is at -3 dB.
    poles : {1, 2}
        One: pi / 2 of the bandwidth. Two, of a Butterworth: pi / sqrt(8).
    """
    _check_poles(poles)
    return float(_positive("bandwidth_hz", bandwidth_hz) * (np.pi / 2 if poles == 1 else np.pi / np.sqrt(8)))


def rms(white: float, bandwidth_hz: float, poles: int = 1) -> float:
    """Return the root mean square of the output noise, sqrt(2 N^2 (noise bandwidth)), in the unit of the readings.

    Parameters
    ----------
    white : float
        N, two-sided, in unit s^(1/2).
    bandwidth_hz : float
        Where the sensor's own low-pass is at -3 dB.
    poles : {1, 2}
        Of that low-pass; two are a Butterworth.

    Raises
    ------
    UsageError
        If a number is not positive, or there are other poles.
    """
    return float(np.sqrt(2 * noise_bandwidth(bandwidth_hz, poles)) * _positive("white", white))


def white_noise_of_rms(value: float, bandwidth_hz: float, poles: int = 1) -> float:
    """Return N, in unit s^(1/2), of a sensor from the root mean square of its output noise: the inverse of `rms`.

    Parameters
    ----------
    value : float
        Root mean square, in the unit of the readings.
    bandwidth_hz, poles
        Of the sensor's own low-pass, as in `rms`.

    Raises
    ------
    UsageError
        If a number is not positive, or there are other poles.
    """
    return float(_positive("value", value) / np.sqrt(2 * noise_bandwidth(bandwidth_hz, poles)))


def quantisation_step(span: float, bits: int) -> float:
    """Return the smallest step of a converter, in the unit of the span.

    Parameters
    ----------
    span : float
        From the lowest to the highest reading: 4 for +-2 g.
    bits : int
        Of the converter, sign included.

    Raises
    ------
    UsageError
        If the span is not positive, or the bits are not 1 to 64.
    """
    if bits not in range(1, 65):
        raise UsageError(f"bits = {bits} is not the width of a converter; give a whole number from 1 to 64.")
    return _positive("span", span) / 2.0**bits


def quantisation_variance(step: float) -> float:
    """Return what rounding to `step`, in unit, adds to R: step^2 / 12, in unit^2.

    It is white and even where the other noise is louder than about half a step; a record that stands on
    one value has no noise that could be averaged.
    """
    return _positive("step", step) ** 2 / 12


def _finite(value: float) -> float:
    """Check a number of a datasheet."""
    return _checked("value", value, 0 <= value < np.inf, "0 or a positive number")


def _positive(name: str, value: float) -> float:
    """Check a number that must be over 0."""
    return _checked(name, value, 0 < value < np.inf, "a positive number")


def _checked(name: str, value: float, fits: bool, needed: str) -> float:
    """Return the number, or say what is needed in its place."""
    if not fits:
        raise UsageError(f"{name} = {value} cannot be; give {needed}.")
    return float(value)


def _check_poles(poles: int) -> None:
    """Check the poles of a sensor's own low-pass."""
    if poles not in (1, 2):
        raise UsageError(f"poles = {poles} is not offered; use 1, or 2 for a Butterworth low-pass.")
