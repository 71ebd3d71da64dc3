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
from becalm.core.kernel_faults import FAR, HELD, LEAST, MOST, RUN
from becalm.core.kernel_outliers import LONGEST_FILL
from becalm.core.kernel_watch import ABOVE, BELOW, COUNT, SQUARES, TOTAL
from becalm.core.monitor import NEVER, SILENT, Alarms
from becalm.core.reach import Reach

HOPS = "hops"
"""What only matters to a channel that may be dead."""


class Before(NamedTuple):
    """What went before a run that begins amid a record, as far as it matters to what is told of its rows."""

    reading: float  # the first of all, in unit
    readings: int  # that came
    rows: int
    steps: float  # from the first row to the last of them
    least: float = np.inf  # of the readings, in unit
    most: float = -np.inf


class Rules(NamedTuple):
    """By what a channel is filtered and watched."""

    reach: Reach
    stuck: int  # equal readings in a row that are called stuck; 0: never
    alarms: Alarms
    remembers: bool = False  # whether the last six readings tell gross outliers


def standing(saved: Mapping[str, Any], rules: Rules) -> dict[str, Floats]:
    """Return what later rows depend on.

    Parameters
    ----------
    saved : mapping of str to array
        What a `PartedFlow` of a `SwitchingFlow`, a `Faults` and an `InnovationMonitor` have saved.
    rules : Rules
        Of the channel.

    Returns
    -------
    dict of str to float array
        Under the names of what they are made of; `HOPS` matters only to a channel that may be dead.
    """
    belief = {"filter": saved["flow_beliefs"], "flow": saved["flow_told"][:1]}
    gaps, alarms = _of_gaps(saved["parted_gaps"], rules.reach), _of_alarms(saved, rules.alarms)
    return (
        belief
        | {"gaps": gaps, HOPS: _of_hops(saved), "alarms": alarms}
        | standing_of_readings(saved, rules.stuck, rules.remembers)
    )


def standing_of_readings(saved: Mapping[str, Any], stuck: int, remembers: bool = False) -> dict[str, Floats]:
    """Return what the verdicts of later readings depend on, where no filter is asked; parameters as of `standing`."""
    offsets, memory = saved["faults_offsets"], saved["faults_memory"]
    past = np.append(memory[HELD], memory[FAR:]) if remembers else np.empty(0)
    return {
        "readings": np.append(_of_readings(memory, max(stuck, LONGEST_FILL) if remembers else stuck), past),
        "rhythm": np.asarray(offsets - offsets[-1], np.float64),
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


def _of_readings(memory: Floats, stuck: int) -> Floats:
    """Return the reading that is held, and for how long; and whether a 0 would end the range so far."""
    if not stuck:
        return np.empty(0)
    least, most = memory[LEAST], memory[MOST]
    return np.array([memory[HELD], min(memory[RUN], stuck), least >= 0.0, most <= 0.0])


def _of_alarms(saved: Mapping[str, Any], alarms: Alarms) -> Floats:
    if alarms.drift_threshold >= NEVER:
        return np.empty(0)
    return np.asarray(saved["monitor_memory"][[ABOVE, BELOW]], np.float64)


def _of_hops(saved: Mapping[str, Any]) -> Floats:
    """Return what tells a dead channel: the hop that is open, those before it, and whether it was dead already."""
    dead = float(saved["monitor_told"][1] == SILENT)
    open_hop = saved["monitor_memory"][[COUNT, TOTAL, SQUARES]]
    return np.concatenate([open_hop, np.ravel(saved["monitor_hops"]), [dead]]).astype(np.float64)
