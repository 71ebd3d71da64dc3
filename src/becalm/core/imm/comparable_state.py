"""Where a causal bank stands between two rows: all that later rows depend on, and nothing else.

Two filters that began in different rows of a record stand alike if these numbers are the same to the bit: then every
later row is told the same. What is saved to go on from holds more: counts since the first row, of which only matters
whether they are large.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.gap_limit import GapLimit
from becalm.core.health.monitor import HOPS


def comparable_state(saved: Mapping[str, Any], gap_limit: GapLimit) -> dict[str, Floats]:
    """Return what later rows depend on, of what a `PartedFlow` of a `SwitchingFlow` has saved.

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
    """Whether two filters stand alike, to the bit; of one that is surely alive later on, hops may begin elsewhere."""
    asked = [name for name in one if not (alive and name == HOPS)]
    return all(np.array_equal(one[name], other[name], equal_nan=True) for name in asked)


def _of_gaps(gaps: Floats, gap_limit: GapLimit) -> Floats:
    """Return the time since the last reading, and what was read before, until any gap within the limit is bridged."""
    now, last, readings = gaps
    far = readings >= gap_limit.readings and gap_limit.spans * last >= gap_limit.longest
    return np.array([now - last, np.inf if far else last, np.inf if far else readings])
