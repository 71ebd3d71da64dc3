"""Where a causal bank stands between two rows: all that later rows depend on, and nothing else.

Two filters that began in different rows of a record stand alike if these numbers are the same to the bit: then every
later row is told the same. What is saved to go on from holds more: counts since the first row, of which only matters
whether they are large.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.monitor import HOPS
from becalm.core.reach import Reach


class Before(NamedTuple):
    """What went before a run that begins amid a record, as far as it matters to what is told of its rows."""

    reading: float  # the first of all, in unit
    readings: int  # that came
    rows: int
    steps: float  # from the first row to the last of them
    least: float = np.inf  # of the readings, in unit
    most: float = -np.inf


def standing(saved: Mapping[str, Any], reach: Reach) -> dict[str, Floats]:
    """Return what later rows depend on, of what a `PartedFlow` of a `SwitchingFlow` has saved.

    Parameters
    ----------
    saved : mapping of str to array
        What it has saved.
    reach : Reach
        Which gaps it is carried across.
    """
    return {
        "filter": saved["flow_modes"],
        "gaps": _of_gaps(saved["parted_gaps"], reach),
    }


def alike(one: Mapping[str, Floats], other: Mapping[str, Floats], *, alive: bool) -> bool:
    """Whether two filters stand alike, to the bit; of one that is surely alive later on, hops may begin elsewhere."""
    asked = [name for name in one if not (alive and name == HOPS)]
    return all(np.array_equal(one[name], other[name], equal_nan=True) for name in asked)


def _of_gaps(gaps: Floats, reach: Reach) -> Floats:
    """Return the time since the last reading, and what was read before, until any gap within reach is bridged."""
    now, last, readings = gaps
    far = readings >= reach.readings and reach.spans * last >= reach.longest
    return np.array([now - last, np.inf if far else last, np.inf if far else readings])
