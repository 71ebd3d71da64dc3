"""Compare the filters' states at the seam of two stretches. If the states differ, the later stretch runs again.

If every stretch starts in exactly the state in which the stretch before it ended, the output equals that of a single
run, and does not depend on the cuts. Smoothed estimates also depend on later rows; therefore smoothed stretches are
compared by their estimates in the rows where they overlap.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from becalm.core.imm.flow import same_state
from becalm.core.snapshot_bytes import unpacked
from becalm.fleet.stretching.long_sensor import State, TaskStretch
from becalm.fleet.stretching.run import StretchEstimates

SMOOTHED_TO = 1e-10
"""Largest allowed difference of two smoothed stretches, relative to the channel's largest value in these rows."""


def to_run_again(estimates: Sequence[StretchEstimates]) -> list[TaskStretch] | None:
    """Return the causal stretches to run again, each with the state in which the stretch before it ended.

    Parameters
    ----------
    estimates : sequence of StretchEstimates
        The results of all stretches of a sensor, in order.

    Returns
    -------
    list of TaskStretch or None
        The stretches that did not start in this state. None if the sensor cannot be cut, because estimates at a seam
        still wait for later rows.
    """
    again = list[TaskStretch]()
    for before, now in pairwise(estimates):
        if before.seams is None:
            continue  # the earlier stretch runs again first
        if before.seams.end is None or before.seams.complete_end is None:
            return None
        if now.seams is None or not _fits(before.seams.end, now.seams.start, now.seams.alive):
            again.append(now.stretch._replace(state=before.seams.complete_end))
    return again


def overlaps_agree(estimates: Sequence[StretchEstimates]) -> bool:
    """Return whether smoothed stretches agree in the rows where they overlap."""
    return all(now.seams is not None for now in estimates) and all(
        _agree(before.seams.next_rows, now.seams.first_rows)
        for before, now in pairwise(estimates)
        if before.seams is not None and now.seams is not None
    )


def _fits(end: State, start: State | None, alive: Sequence[bool]) -> bool:
    if start is None:
        return False
    pairs = zip(end, start, alive, strict=True)
    return all(same_state(unpacked(one), unpacked(other), alive=sure) for one, other, sure in pairs)


def _agree(one: np.ndarray | None, other: np.ndarray | None) -> bool:
    """Return whether two arrays of signals and sigmas (m, 2, n) agree, each channel relative to its largest value."""
    if one is None or other is None:
        return False
    rows = min(one.shape[2], other.shape[2])
    one, other = one[..., :rows], other[..., :rows]
    scale = np.nanmax(np.abs(np.where(np.isfinite(other), other, np.nan)), axis=(1, 2), keepdims=True, initial=0.0)
    same = (one == other) | (np.isnan(one) & np.isnan(other))
    with np.errstate(invalid="ignore"):
        return bool(np.all(same | (np.abs(one - other) <= SMOOTHED_TO * scale)))
