"""The innovation gate of one channel: it rejects spikes, follows steps, and accepts readings again after a few rows."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral

import numpy as np

from becalm.core.model.model import Model
from becalm.core.model.parts import checked_number
from becalm.core.reading_verdicts import AGREE, AT_MOST
from becalm.errors import ModelError
from becalm.native.library import CONSTANTS

JUMP_READINGS, WIDE = CONSTANTS["GOES_ON"], float(CONSTANTS["WIDE"])
"""`JUMP_READINGS`: while fewer readings than this were used since a jump, a rejected reading counts as part of the jump
and is used, unless its innovation is far larger than those of the jump.
`WIDE`: the largest variance that a jump adds, over R; a larger covariance would lose the digits of the readings."""

LEAST_THRESHOLD = 4.0
"""Smallest threshold; a narrower gate would reject more good measurements than bad ones."""


def threshold_for(false_alarms_per_hour: float, readings_per_second: float) -> float:
    """Return the gate's threshold in standard deviations for a rate of false alarms.

    Parameters
    ----------
    false_alarms_per_hour : float
        Number of good readings with Gaussian noise that the gate rejects per hour; a *small* rate trusts the readings.
    readings_per_second : float
        Rate of the readings, in Hz.

    Returns
    -------
    float
        Phi^-1(1 - p/2) with p false alarms per reading: 5.0 for one per hour at 500 Hz, 5.55 at 10 kHz; at least 4.

    Raises
    ------
    ModelError
        If one of the rates is not a positive number.

    Examples
    --------
    >>> round(threshold_for(1.0, 10_000.0), 2)
    5.55
    """
    from scipy.special import ndtri

    for name, value in (("false_alarms_per_hour", false_alarms_per_hour), ("readings_per_second", readings_per_second)):
        checked_number(name, value, "a rate", "a positive number")
    share = false_alarms_per_hour / (3600 * readings_per_second)
    return max(LEAST_THRESHOLD, float(-ndtri(max(min(share, 1.0) / 2, np.finfo(float).tiny))))


@dataclass(frozen=True)
class Gate:
    """The settings of an innovation gate: when it rejects a reading, and when it accepts rejected readings after all.

    Attributes
    ----------
    threshold : float
        z: a reading whose innovation exceeds z expected standard deviations is a spike, and counts as missing.
        A *small* threshold trusts the model. `threshold_for` gives the threshold for a rate of false alarms.
    agree : int
        This many rejected readings in a row that agree with each other, within z times their noise, are a step, and the
        filter follows it. With a *small* number it follows a step sooner, but also spikes that agree by chance.
    at_most : int
        This many rejected readings in a row are accepted in any case, so that the filter cannot reject readings for
        ever.
        A *small* number trusts the readings.

    Raises
    ------
    ModelError
        If the threshold is not positive, or `agree` is less than 2 or more than `at_most`.
    """

    threshold: float
    agree: int = AGREE
    at_most: int = AT_MOST

    def __post_init__(self) -> None:
        """Raise a ModelError if a value is not possible."""
        checked_number("threshold", self.threshold, "a threshold", "a positive number, as threshold_for does")
        whole = isinstance(self.agree, Integral) and isinstance(self.at_most, Integral)
        if not (whole and 2 <= self.agree <= self.at_most):
            raise ModelError(
                f"agree = {self.agree!r} and at_most = {self.at_most!r} came; 2 <= agree <= at_most is needed."
                f" Leave them out for {AGREE} and {AT_MOST}."
            )


def level_of(model: Model) -> int:
    """Return the index of the level, a measured state that a step leaves constant; -1 if there is none."""
    kept = np.all(np.eye(model.states) == model.F, axis=0) & (model.H[0] != 0)
    return int(kept.argmax()) if kept.any() else -1
