"""Read a sample rate from a name, a number and a unit: `fs`, 100, "Hz"; or `dt`, 10, "ms"."""

from __future__ import annotations

import re

import numpy as np

from becalm.core.time.clock import FASTEST_HZ, SLOWEST_HZ
from becalm.files.units.unit_spelling import parse_header, tidy_unit

_RATES = re.compile(r"fs|fsample|sr|srate|rate|sampl(?:e|ing)(?:rate|freq|frequency)|samplespersecond|freqsampling")
_STEPS = re.compile(
    r"dt|ts|deltat|timestep|timeincrement|wfincrement|tinterval|xspacing|sampl(?:e|ing)(?:interval|period|time|step)"
)
_HERTZ = {"Hz": 1.0, "hz": 1.0, "HZ": 1.0, "kHz": 1e3, "MHz": 1e6, "S/s": 1.0, "Sa/s": 1.0, "1/s": 1.0, "": 1.0}
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "": 1.0}


def hertz_of(name: str, number: float, unit: str = "") -> float | None:
    """Return the rate in Hz from a number named as a rate or a step; None for other names and implausible rates.

    Parameters
    ----------
    name : str
        The name of the number; it may end in a unit.
    number : float
        The rate or the step.
    unit : str
        The unit of the number; if "", the unit in the name is used, or Hz or seconds if the name has none. If `unit`
        and the unit in the name differ, or a unit is unknown, the result is None.
    """
    scales = _HERTZ if _is(_RATES, name) else _SECONDS if _is(_STEPS, name) else {}
    units = [tidy_unit(one) for one in (unit, parse_header(name)[1]) if one] or [""]
    found = {scales.get(one, np.nan) for one in units}
    scale = found.pop() if len(found) == 1 else np.nan
    rate = number * scale if scales is _HERTZ else 1.0 / (number * scale) if number > 0 else np.nan
    return float(rate) if SLOWEST_HZ <= rate <= FASTEST_HZ else None


def _is(words: re.Pattern[str], name: str) -> bool:
    return words.fullmatch(re.sub(r"[\W_]+", "", parse_header(name)[0].lower())) is not None
