"""The part of a causal filter's state that later estimates depend on, so that two filters can be compared.

Two filters that began in different rows of a record estimate every later row alike if these numbers are bitwise equal.
A checkpoint holds more: counts since the first row, which matter only until they are large.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.gap_limit import GapLimit
from becalm.core.health.monitor import HOPS


def comparable_state(saved: Mapping[str, Any], gap_limit: GapLimit) -> dict[str, Floats]:
    """Return what later rows depend on, of what a `RestartingFlow` of an `ImmFlow` has saved.

    Parameters
    ----------
    saved : mapping of str to array
        What it has saved.
    gap_limit : GapLimit
        Which gaps it is carried across.
    """
    return {
        "filter": saved["flow_modes"],
        "gaps": _of_gaps(saved["parted_gaps"], gap_limit),
    }


def same_state(one: Mapping[str, Floats], other: Mapping[str, Floats], *, alive: bool) -> bool:
    """Return whether two filter states are bitwise equal.

    The phase of the dead-sensor window is ignored for channels that are known to be alive.
    """
    asked = [name for name in one if not (alive and name == HOPS)]
    return all(np.array_equal(one[name], other[name], equal_nan=True) for name in asked)


def _of_gaps(gaps: Floats, gap_limit: GapLimit) -> Floats:
    """Return the time since the last reading, and what was read before, until any gap within the limit is bridged."""
    now, last, readings = gaps
    far = readings >= gap_limit.readings and gap_limit.spans * last >= gap_limit.longest
    return np.array([now - last, np.inf if far else last, np.inf if far else readings])
