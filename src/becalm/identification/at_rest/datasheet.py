"""Convert datasheet numbers to R and q, and back.

Two densities of the same white noise have the same unit. A *noise density* n_d, in ug/sqrt(Hz) or (deg/s)/sqrt(Hz), is
one-sided: its square fills the band from 0 to half of the rate. An *angle* or *velocity random walk* N, in deg/sqrt(h)
or (m/s)/sqrt(h), is two-sided, and is what an Allan deviation shows: N = n_d / sqrt(2). The variance of one reading is
R = N^2 rate = n_d^2 rate / 2.

The unit shows which of the two is meant: one-sided per root of hertz, two-sided per root of time. If a datasheet states
explicitly that its density per root of hertz is two-sided, use `convert` with the unit before the root; the result is
N. The table of units (`datasheet_units`) is fixed. Source: IEEE Std 952-1997, annex C.
"""

from __future__ import annotations

import numpy as np

from becalm.errors import UsageError
from becalm.identification.at_rest.datasheet_units import reading_size, walk_size, white_size


def convert(value: float, unit: str, reading_unit: str) -> float:
    """Convert a bias, a step or another reading to another unit.

    Parameters
    ----------
    value : float
        The number in `unit`.
    unit, reading_unit : str
        One of m/s^2, g, mg, ug; rad/s, deg/s, mdeg/s, deg/h; m/m, um/m, nm/m.

    Raises
    ------
    UsageError
        If a unit is not in the table, the two have different quantities, or the value is not finite.
    """
    return _checked("value", value, bool(np.isfinite(value)), "a number") * reading_size(unit, reading_unit)


def white_noise(value: float, unit: str, reading_unit: str) -> float:
    """Convert a datasheet's white noise to N, two-sided, in reading_unit s^(1/2).

    Parameters
    ----------
    value : float
        The datasheet's number, in `unit`.
    unit : str
        One-sided per sqrt(Hz), such as "ug/sqrt(Hz)", "(deg/s)/sqrt(Hz)", "um/m/sqrt(Hz)"; or two-sided for the
        reading's integral, such as "deg/sqrt(h)", "(m/s)/sqrt(h)".
    reading_unit : str
        Unit of the readings to be filtered, such as "m/s^2".

    Raises
    ------
    UsageError
        If the unit is not one of white noise, or belongs to another quantity.
    """
    return _finite(value) * white_size(unit, reading_unit)


def white_noise_in(unit: str, white: float, reading_unit: str) -> float:
    """Convert N to a datasheet's white noise: the inverse of `white_noise`.

    Parameters
    ----------
    unit : str
        Unit of the result, such as "ug/sqrt(Hz)" or "deg/sqrt(h)".
    white : float
        N, two-sided, in reading_unit s^(1/2).
    reading_unit : str
        Unit of the readings, such as "m/s^2".

    Raises
    ------
    UsageError
        If the unit is not one of white noise, or belongs to another quantity.
    """
    return _finite(white) / white_size(unit, reading_unit)


def random_walk(value: float, unit: str, reading_unit: str) -> float:
    """Convert a datasheet's rate random walk to K, in reading_unit / s^(1/2).

    Its square is the `noise_density` of `components.level`.

    Parameters
    ----------
    value : float
        The datasheet's number, in `unit`.
    unit : str
        Unit of a reading per root of time, such as "deg/s/sqrt(h)", "deg/h/sqrt(h)", "ug/sqrt(s)".
    reading_unit : str
        Unit of the readings to be filtered, such as "deg/s".

    Raises
    ------
    UsageError
        If the unit is not one of a random walk, or belongs to another quantity.
    """
    return _finite(value) * walk_size(unit, reading_unit)


def random_walk_in(unit: str, walk: float, reading_unit: str) -> float:
    """Convert K to a datasheet's rate random walk: the inverse of `random_walk`.

    Parameters
    ----------
    unit : str
        Unit of the result, such as "deg/h/sqrt(h)" or "ug/sqrt(s)".
    walk : float
        K, in reading_unit / s^(1/2).
    reading_unit : str
        Unit of the readings, such as "deg/s".

    Raises
    ------
    UsageError
        If the unit is not one of a random walk, or belongs to another quantity.
    """
    return _finite(walk) / walk_size(unit, reading_unit)


def random_walk_of_stability(lowest_deviation: float, white: float) -> float:
    """Return K, in unit / s^(1/2), from an in-run bias stability: the lowest point of the Allan deviation.

    Parameters
    ----------
    lowest_deviation : float
        The bias stability, in the unit of the readings; a *small* one trusts the bias and follows it slowly.
    white : float
        N, in unit s^(1/2).

    Raises
    ------
    UsageError
        If a number is not positive.

    Notes
    -----
    White noise and a random walk alone have their lowest point at tau = sqrt(3) N / K, where sigma^2 = 2 N K / sqrt(3).
    If the curve has a flat stretch between the two, the result is an upper bound of K.
    """
    return float(np.sqrt(3) / 2 * _positive("lowest_deviation", lowest_deviation) ** 2 / _positive("white", white))


def noise_variance(white: float, rate_hz: float, bandwidth_hz: float = np.inf, poles: int = 1) -> float:
    """Return R, the variance of one reading's white noise, in unit^2.

    Parameters
    ----------
    white : float
        N, two-sided, in unit s^(1/2), from `white_noise`.
    rate_hz : float
        Readings per second.
    bandwidth_hz : float
        -3 dB bandwidth of the sensor's own low-pass; inf for a sensor that averages between two readings.
    poles : {1, 2}
        Number of poles of that low-pass; two are a Butterworth.

    Raises
    ------
    UsageError
        If a number is not positive, or `poles` is neither 1 nor 2.

    Notes
    -----
    Noise above half of the rate is aliased. For a filter slower than the sensor, the aliased density at low frequencies
    counts: R = N^2 rate times the sum of abs(H(k rate))^2 over k, here in closed form. R goes from N^2 rate, for a
    bandwidth far below the rate, to 2 N^2 (noise bandwidth), for a bandwidth far above it. In the first case the
    readings are correlated, and their own variance `rms(...)^2` would be too small. A sensor whose bandwidth exceeds
    half of the rate is noisier than n_d^2 rate / 2.
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
    """Return the width, in Hz, of the ideal low-pass that passes the same power of white noise.

    Parameters
    ----------
    bandwidth_hz : float
        -3 dB bandwidth of the low-pass.
    poles : {1, 2}
        Number of poles: the width is pi / 2 of the bandwidth for one, pi / sqrt(8) for two, a Butterworth.

    Raises
    ------
    UsageError
        If the bandwidth is not positive, or `poles` is neither 1 nor 2.
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
        -3 dB bandwidth of the sensor's own low-pass.
    poles : {1, 2}
        Number of poles of that low-pass; two are a Butterworth.

    Raises
    ------
    UsageError
        If a number is not positive, or `poles` is neither 1 nor 2.
    """
    return float(np.sqrt(2 * noise_bandwidth(bandwidth_hz, poles)) * _positive("white", white))


def white_noise_of_rms(value: float, bandwidth_hz: float, poles: int = 1) -> float:
    """Return N, in unit s^(1/2), of a sensor from the RMS of its output noise: the inverse of `rms`.

    Parameters
    ----------
    value : float
        Root mean square, in the unit of the readings.
    bandwidth_hz, poles
        Bandwidth and poles of the sensor's own low-pass, as in `rms`.

    Raises
    ------
    UsageError
        If a number is not positive, or `poles` is neither 1 nor 2.
    """
    return float(_positive("value", value) / np.sqrt(2 * noise_bandwidth(bandwidth_hz, poles)))


def quantisation_step(span: float, bits: int) -> float:
    """Return the smallest step of a converter, in the unit of the span.

    Parameters
    ----------
    span : float
        Difference of the highest and the lowest reading: 4 for +-2 g.
    bits : int
        Word length of the converter, sign included.

    Raises
    ------
    UsageError
        If the span is not positive, or `bits` is not 1 to 64.
    """
    if bits not in range(1, 65):
        raise UsageError(f"bits = {bits} is not the width of a converter; give a whole number from 1 to 64.")
    return _positive("span", span) / 2.0**bits


def quantisation_variance(step: float) -> float:
    """Return the variance that rounding to `step`, in unit, adds to R: step^2 / 12, in unit^2.

    The rounding error is white and uniform where the standard deviation of the other noise exceeds about half a step.
    In a constant record there is no noise to average, and the rounding error remains.

    Raises
    ------
    UsageError
        If the step is not positive.
    """
    return _positive("step", step) ** 2 / 12


def _finite(value: float) -> float:
    """Return a number of a datasheet, or raise a UsageError if it is negative or not finite."""
    return _checked("value", value, 0 <= value < np.inf, "0 or a positive number")


def _positive(name: str, value: float) -> float:
    """Return a number, or raise a UsageError if it is not positive and finite."""
    return _checked(name, value, 0 < value < np.inf, "a positive number")


def _checked(name: str, value: float, fits: bool, needed: str) -> float:
    """Return the number, or raise a UsageError that names what is needed."""
    if not fits:
        raise UsageError(f"{name} = {value} is not possible; give {needed}.")
    return float(value)


def _check_poles(poles: int) -> None:
    """Raise a UsageError if the number of poles of a sensor's own low-pass is neither 1 nor 2."""
    if poles not in (1, 2):
        raise UsageError(f"poles = {poles} is not supported; use 1, or 2 for a Butterworth low-pass.")
