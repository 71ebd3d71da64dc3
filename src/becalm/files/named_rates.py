"""Read a sample rate from a name, a number and a unit: `fs`, 100, "Hz"; or `dt`, 10, "ms"."""

from __future__ import annotations

import re

import numpy as np

from becalm.core.time.clock import FASTEST_HZ, SLOWEST_HZ
from becalm.files.unit_spelling import parse_header, tidy_unit

_RATES = re.compile(r"fs|fsample|sr|srate|rate|sampl(?:e|ing)(?:rate|freq|frequency)|samplespersecond|freqsampling")
_STEPS = re.compile(
    r"dt|ts|deltat|timestep|timeincrement|wfincrement|tinterval|xspacing|sampl(?:e|ing)(?:interval|period|time|step)"
)
_HERTZ = {"Hz": 1.0, "hz": 1.0, "HZ": 1.0, "kHz": 1e3, "MHz": 1e6, "S/s": 1.0, "Sa/s": 1.0, "1/s": 1.0, "": 1.0}
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "": 1.0}


def hertz_of(name: str, number: float, unit: str = "") -> float | None:
    """Return the rate in Hz from a number that is named as a rate or a step; None if it is neither, or out of range.

    Parameters
    ----------
    name : str
        The name of the number; it may end in a unit.
    number : float
        The rate or the step.
    unit : str
        The unit of the number; with "" it is the unit in the name, or else Hz or seconds.
    """
    if unit:
        number = in_hertz_or_seconds(name, number, unit)
    unit = parse_header(name)[1]
    rate = None
    if _is(_RATES, name):
        rate = number * _HERTZ.get(unit, np.nan)
    elif _is(_STEPS, name) and number > 0:
        rate = 1.0 / (number * _SECONDS.get(unit, np.nan))
    return rate if rate is not None and SLOWEST_HZ <= rate <= FASTEST_HZ else None


def in_hertz_or_seconds(name: str, number: float, unit: str) -> float:
    """Return a rate in Hz or a step in s; NaN if the unit is unknown."""
    spelt = tidy_unit(unit)
    scale = _HERTZ.get(spelt) if _is(_RATES, name) else _SECONDS.get(spelt)
    return number * scale if scale else np.nan


def _is(words: re.Pattern[str], name: str) -> bool:
    return words.fullmatch(re.sub(r"[\W_]+", "", parse_header(name)[0].lower())) is not None
