"""The gate of a filter of one channel: spikes are left out, steps are followed, and nothing is locked out."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np

from becalm.core.model.model import Model
from becalm.core.verdict import AGREE, AT_MOST
from becalm.errors import ModelError
from becalm.native.library import CONSTANTS

GOES_ON, WIDE = CONSTANTS["GOES_ON"], float(CONSTANTS["WIDE"])
"""Readings used since a jump, before which a reject is the same motion that goes on, and believed at once; and how many
times R a jump adds at the most: a covariance beyond loses the digits of the readings."""

LEAST_THRESHOLD = 4.0
"""Smallest threshold: a narrower gate would reject more good measurements than bad ones."""


def threshold_for(false_alarms_per_hour: float, readings_per_second: float) -> float:
    """Return how many standard deviations an innovation may have, for so many good readings rejected an hour.

    Parameters
    ----------
    false_alarms_per_hour : float
        Of Gaussian noise; a *small* one trusts the readings.
    readings_per_second : float
        How often a reading is judged.

    Returns
    -------
    float
        Phi^-1(1 - p/2) with p false alarms a reading: 5.0 for one an hour at 500 Hz, 5.55 at 10 kHz; never
        less than 4.

    Raises
    ------
    ModelError
        If one of them is not a positive number.

    Examples
    --------
    >>> round(threshold_for(1.0, 10_000.0), 2)
    5.55
    """
    from scipy.special import ndtri

    for name, value in (("false_alarms_per_hour", false_alarms_per_hour), ("readings_per_second", readings_per_second)):
        if not 0 < value < np.inf:
            raise ModelError(f"{name} = {value} is no rate; give a positive number.")
    share = false_alarms_per_hour / (3600 * readings_per_second)
    return max(LEAST_THRESHOLD, float(-ndtri(max(min(share, 1.0) / 2, np.finfo(float).tiny))))


@dataclass(frozen=True)
class Gate:
    """When a reading is not believed, and when it is after all.

    Attributes
    ----------
    threshold : float
        z: a reading whose innovation exceeds z of its standard deviations is a spike, and counts as missing;
        a *small* one trusts the model. `threshold_for` gives it for a rate of false alarms.
    agree : int
        So many rejects in a row that agree with each other, to z of their noise, are a step: it is followed.
        With a *small* one sooner, but spikes that agree by chance are followed too.
    at_most : int
        So many rejects in a row are believed whatever they are, so that nothing is locked out for ever; a *small*
        one trusts the readings.

    Raises
    ------
    ModelError
        If the threshold is not positive, or `agree` is less than 2 or more than `at_most`.
    """

    threshold: float
    agree: int = AGREE
    at_most: int = AT_MOST

    def __post_init__(self) -> None:
        """Refuse what is no gate."""
        if not (isinstance(self.threshold, Real) and 0 < self.threshold < np.inf):
            raise ModelError(
                f"threshold = {self.threshold!r} is no gate; give a positive number, as threshold_for does."
            )
        whole = isinstance(self.agree, Integral) and isinstance(self.at_most, Integral)
        if not (whole and 2 <= self.agree <= self.at_most):
            raise ModelError(
                f"agree = {self.agree!r} and at_most = {self.at_most!r} came; 2 <= agree <= at_most is needed."
                f" Leave them out for {AGREE} and {AT_MOST}."
            )


def level_of(model: Model) -> int:
    """Return the state to which a jump adds: one that keeps whatever is added to it, and is read; -1 for none."""
    kept = np.all(np.eye(model.states) == model.F, axis=0) & (model.H[0] != 0)
    return int(kept.argmax()) if kept.any() else -1
