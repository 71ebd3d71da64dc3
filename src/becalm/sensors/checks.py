"""Check the numbers that describe a sensor, with messages for the user."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats, frozen, real
from becalm.errors import SensorError

STANDARD_GRAVITY = 9.80665
"""g, in m/s^2, by definition; the local value on Earth differs from it by up to 0.3 %."""


def finite(name: str, value: object, example: str) -> float:
    """Return a finite number as float.

    Raises
    ------
    SensorError
        If the value is not a finite number; booleans and text are not numbers.
    """
    number = _number(value)
    if not np.isfinite(number):
        raise SensorError(f"{name} = {value!r} is not a finite number; give one, e.g. {example}.")
    return number


def positive(name: str, value: object, example: str, *, zero: bool = False) -> float:
    """Return a finite number above zero, or at least zero if `zero` is True, as float.

    Raises
    ------
    SensorError
        If the value is not a finite number, is negative, or is 0 where 0 is not allowed.
    """
    number = _number(value)
    if not (0 < number < np.inf or (zero and number == 0)):
        what = "zero or a positive number" if zero else "a positive number"
        raise SensorError(f"{name} = {value!r} is not {what}; give one, e.g. {example}.")
    return number


def finite_array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """Return a read-only copy of an array of finite numbers with the given shape.

    Raises
    ------
    SensorError
        If the array has another shape, or an entry is not a finite number.
    """
    try:
        own = frozen(real(values))
    except (TypeError, ValueError) as cause:
        raise SensorError(f"{name} does not hold numbers ({cause}); give shape {shape}.") from cause
    if own.shape != shape:
        raise SensorError(f"{name} has shape {own.shape}; give shape {shape}.")
    if not np.isfinite(own).all():
        raise SensorError(f"{name} holds numbers that are not finite; give {own.size} finite numbers.")
    return own


def _number(value: object) -> float:
    """Return a number as float, and NaN for anything else."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        return np.nan
    return float(value)
