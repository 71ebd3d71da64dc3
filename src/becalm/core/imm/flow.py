"""Filter or smooth one channel of any length by interacting multiple models, block by block and in constant memory.

The filter continues from the state after the previous block. The smoother works on groups with a fixed number of rows,
counted from the first row, so that the boundaries between pushes change no bit. It smooths a group once the next group
is complete. Groups are so long that the rows after the next group have no influence, even in the calmest mode.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.filter.channel_settings import GapLimit
from becalm.core.health.monitor import HOPS
from becalm.core.imm.forward import ForwardImm, ImmFlowBase, with_spikes
from becalm.core.imm.modes import InteractingModels, numbered_steps
from becalm.core.rows import EstimatedRows, Judge, Rows
from becalm.core.steady.steady_filter import NEGLIGIBLE_SHARE, rows_until_decayed
from becalm.native.imm import (
    BLOCK,
    NO_BUFFERS,
    ModeMatrices,
    Steps,
    blocks_before,
    nothing_later,
    smooth_rows,
)

_LEAST_GROUP = 64 * BLOCK  # rows
_MOST_GROUP = 1 << 22  # rows: a mode with a longer memory is almost a constant


class _Group(NamedTuple):
    """Filtered rows, with all that the smoother needs."""

    matrices: ModeMatrices
    z: Floats  # (B,)
    steps: Steps  # (B,)
    before: Floats  # (blocks, K) filter states before each block
    verdicts: Codes  # (B,)


class ImmFlow(ImmFlowBase):
    """An IMM filter or smoother of one channel; a push may have any number of rows.

    Parameters
    ----------
    switching : InteractingModels
        The modes, in steps.
    causal : bool
        True to filter, False to smooth.
    judge : callable, optional
        It receives the innovations of each block, for the mixture of all modes, and their standard deviations.
    split : bool
        Whether to return also the contribution of each part of the component, then the probability of each mode.
    with_probabilities : bool
        Whether to return the probabilities without the contributions; used only if `split` is False.
    """

    def __init__(
        self,
        switching: InteractingModels,
        *,
        causal: bool,
        judge: Judge | None = None,
        split: bool = False,
        with_probabilities: bool = False,
    ) -> None:
        self._causal = causal
        super().__init__(ForwardImm(switching, judge, split=split, with_probabilities=with_probabilities))
        self._group = _LEAST_GROUP if causal else _group_rows(switching)
        self._incomplete = Rows.empty()
        self._unsmoothed: _Group | None = None

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return the rows whose estimates are final."""
        judged = self._filter.judged(z)
        if self._causal:
            return [self._take(Rows(judged.readings, elapsed, judged.verdicts))[1]]
        estimates = list[EstimatedRows]()
        rows = Rows.joined([self._incomplete, Rows(judged.readings, elapsed, judged.verdicts)])
        while len(rows.z) >= self._group:
            estimates += self._take_group(rows.part(slice(self._group)))
            rows = rows.part(slice(self._group, None))
        self._incomplete = rows
        return estimates

    def finish(self) -> list[EstimatedRows]:
        """End the record; return the rows that were waiting."""
        estimates = self._take_group(self._incomplete) if len(self._incomplete.z) else []
        self._incomplete = Rows.empty()
        if self._unsmoothed is not None:
            estimates.append(self._smooth(self._unsmoothed, nothing_later(self._unsmoothed.matrices)))
            self._unsmoothed = None
        return estimates

    def _take_group(self, rows: Rows) -> list[EstimatedRows]:
        """Filter a group, and smooth the previous group."""
        group, _ = self._take(rows)
        previous, self._unsmoothed = self._unsmoothed, group
        if previous is None:
            return []
        information = nothing_later(group.matrices)
        smooth_rows(group.matrices, self._filter.state, group.z, group.steps, group.before, information, NO_BUFFERS)
        return [self._smooth(previous, information)]

    def _take(self, rows: Rows) -> tuple[_Group, EstimatedRows]:
        lengths, steps = numbered_steps(rows.elapsed)
        matrices, z = self.switching.matrices(lengths), np.ascontiguousarray(rows.z)
        before = blocks_before(matrices, 0 if self._causal else len(z))
        buffers = self._filter.run(z, matrices, steps, before=None if self._causal else before)
        verdicts = with_spikes(rows.verdicts, buffers)
        return _Group(matrices, z, steps, before, verdicts), self._filter.estimates_from(buffers, verdicts)

    def _smooth(self, group: _Group, information: Floats) -> EstimatedRows:
        """Smooth a group with the information of the rows after it."""
        buffers = self._filter.new_buffers(len(group.z))
        smooth_rows(group.matrices, self._filter.state, group.z, group.steps, group.before, information, buffers)
        return self._filter.estimates_from(buffers, group.verdicts)


def _group_rows(switching: InteractingModels) -> int:
    """Return the number of rows after which even the calmest mode has no memory, in whole blocks."""
    models = [mode.component.to_model(1.0, mode.noise_variance) for mode in switching.modes]
    longest = max(rows_until_decayed(NEGLIGIBLE_SHARE, model) for model in models)
    return max(_LEAST_GROUP, int(min(longest, _MOST_GROUP)) // BLOCK * BLOCK)


# The part of a causal filter's state that later estimates depend on, for the comparison of two filters.
#
# Two filters that started at different rows of a record give equal estimates for every later row if these numbers are
# bitwise equal. A checkpoint also has counts since the first row, which matter only while they are small.


def comparable_state(saved: Mapping[str, Any], gap_limit: GapLimit) -> dict[str, Floats]:
    """Return the part of a saved state that later rows depend on, for a `RestartingFlow` with an inner `ImmFlow`.

    Parameters
    ----------
    saved : mapping of str to array
        The result of `RestartingFlow.state_dict`.
    gap_limit : GapLimit
        The gaps that the filter bridges.
    """
    return {
        "filter": saved["flow_modes"],
        "gaps": _comparable_gaps(saved["parted_gaps"], gap_limit),
    }


def same_state(one: Mapping[str, Floats], other: Mapping[str, Floats], *, alive: bool) -> bool:
    """Return whether two filter states are bitwise equal.

    The phase of the dead-sensor window is ignored for channels that are known to be alive.
    """
    compared = [name for name in one if not (alive and name == HOPS)]
    return all(np.array_equal(one[name], other[name], equal_nan=True) for name in compared)


def _comparable_gaps(gaps: Floats, gap_limit: GapLimit) -> Floats:
    """Return the time since the last reading, the time that the readings span, and their number.

    The time span and the number are inf once they are so large that they do not reduce the longest gap.
    """
    now, last_reading, readings = gaps
    saturated = readings >= gap_limit.readings and gap_limit.spans * last_reading >= gap_limit.longest
    return np.array([now - last_reading, np.inf if saturated else last_reading, np.inf if saturated else readings])
