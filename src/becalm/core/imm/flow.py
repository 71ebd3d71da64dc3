"""Filter or smooth one channel of any length by interacting multiple models, block by block and in constant memory.

The filter continues from the state after the block before. The smoother works on groups of one length, counted from the
start, so that the cuts between pushes change no bit. It smooths a group when the next one is complete. Groups are so
long that even in the calmest mode the rows after the next group have no influence.
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
    NOTHING_WANTED,
    Bank,
    Steps,
    blocks_before,
    nothing_later,
    smooth_rows,
)

_LEAST_GROUP = 64 * BLOCK  # rows
_MOST_GROUP = 1 << 22  # rows: a mode with a longer memory is almost a constant


class _Stretch(NamedTuple):
    """Filtered rows, with all that the smoother needs."""

    bank: Bank
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
        Whether to return the contribution of each part of the component, followed by the probability of each mode.
    with_probabilities : bool
        If `split` is False: whether to return the probabilities alone.
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
        self._incomplete = Rows.nothing()
        self._held: _Stretch | None = None

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
        self._incomplete = Rows.nothing()
        if self._held is not None:
            estimates.append(self._smooth(self._held, nothing_later(self._held.bank)))
            self._held = None
        return estimates

    def _take_group(self, rows: Rows) -> list[EstimatedRows]:
        """Filter a group, and smooth the one before it."""
        stretch, _ = self._take(rows)
        before, self._held = self._held, stretch
        if before is None:
            return []
        later = nothing_later(stretch.bank)
        smooth_rows(stretch.bank, self._filter.state, stretch.z, stretch.steps, stretch.before, later, NOTHING_WANTED)
        return [self._smooth(before, later)]

    def _take(self, rows: Rows) -> tuple[_Stretch, EstimatedRows]:
        lengths, steps = numbered_steps(rows.elapsed)
        bank, z = self.switching.bank(lengths), np.ascontiguousarray(rows.z)
        before = blocks_before(bank, 0 if self._causal else len(z))
        trace = self._filter.run(z, bank, steps, before=None if self._causal else before)
        verdicts = with_spikes(rows.verdicts, trace)
        return _Stretch(bank, z, steps, before, verdicts), self._filter.estimates_from(trace, verdicts)

    def _smooth(self, stretch: _Stretch, later: Floats) -> EstimatedRows:
        """Smooth a stretch with the information of the rows after it."""
        trace = self._filter.room(len(stretch.z))
        smooth_rows(stretch.bank, self._filter.state, stretch.z, stretch.steps, stretch.before, later, trace)
        return self._filter.estimates_from(trace, stretch.verdicts)


def _group_rows(switching: InteractingModels) -> int:
    """Return the number of rows after which even the calmest mode has no memory, in whole blocks."""
    models = [mode.component.to_model(1.0, mode.noise_variance) for mode in switching.modes]
    longest = max(rows_until_decayed(NEGLIGIBLE_SHARE, model) for model in models)
    return max(_LEAST_GROUP, int(min(longest, _MOST_GROUP)) // BLOCK * BLOCK)


# The part of a causal filter's state that later estimates depend on, so that two filters can be compared.
#
# Two filters that started in different rows of a record give equal estimates for every later row if these numbers are
# bitwise equal. A checkpoint has more: counts since the first row, which matter only until they are large.


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
