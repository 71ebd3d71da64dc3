"""The part of a causal filter's state that later estimates depend on, so that two filters can be compared.

Two filters that started in different rows of a record give equal estimates for every later row if these numbers are
bitwise equal. A checkpoint has more: counts since the first row, which matter only until they are large.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.channel_settings import GapLimit
from becalm.core.health.monitor import HOPS


def comparable_state(saved: Mapping[str, Any], gap_limit: GapLimit) -> dict[str, Floats]:
    """Return the part that later rows depend on from the saved state of a `RestartingFlow` with an `ImmFlow` in it.

    Parameters
    ----------
    saved : mapping of str to array
        The result of `RestartingFlow.saved`.
    gap_limit : GapLimit
        The gaps that the filter bridges.
    """
    return {
        "filter": saved["flow_modes"],
        "gaps": _of_gaps(saved["parted_gaps"], gap_limit),
    }


def same_state(one: Mapping[str, Floats], other: Mapping[str, Floats], *, alive: bool) -> bool:
    """Return whether two filter states are bitwise equal.

    The phase of the dead-sensor window is ignored for channels that are known to be alive.
    """
    compared = [name for name in one if not (alive and name == HOPS)]
    return all(np.array_equal(one[name], other[name], equal_nan=True) for name in compared)


def _of_gaps(gaps: Floats, gap_limit: GapLimit) -> Floats:
    """Return the time since the last reading, the time that readings span, and their number.

    The last two are inf once they are so large that the filter bridges every gap within the limit.
    """
    now, last, readings = gaps
    far = readings >= gap_limit.readings and gap_limit.spans * last >= gap_limit.longest
    return np.array([now - last, np.inf if far else last, np.inf if far else readings])
