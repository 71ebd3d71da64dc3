"""A channel of any length through interacting multiple models, a stretch of rows at a time, in constant memory.

Causal, each stretch goes on from the beliefs after the one before. Smoothed, rows come in groups whose bounds
are counted from the start, so that cuts change no bit; a group is smoothed when the next one is complete, and
groups are so long that the calmest mode has forgotten, by then, what comes after.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.imm.forward import ByModes, ForwardImm, with_spikes
from becalm.core.imm.modes import InteractingModels, numbered_steps
from becalm.core.rows import EstimatedRows, Judge, Rows
from becalm.core.steady.steady_gain import FORGOTTEN, rows_until
from becalm.native.imm import (
    BLOCK,
    NOTHING_WANTED,
    Bank,
    Steps,
    blocks_before,
    nothing_later,
    smooth_rows,
)

_LEAST_GROUP = 64 * BLOCK
_MOST_GROUP = 1 << 22  # rows: a calmer mode than these tell is all but a constant


class _Stretch(NamedTuple):
    """Rows that were filtered, with what it takes to smooth them."""

    bank: Bank
    z: Floats  # (B,)
    steps: Steps  # (B,)
    before: Floats  # (blocks, K) beliefs before each block
    verdicts: Codes  # (B,)


class ImmFlow(ByModes):
    """A filter, or a smoother, that switches, of one channel that is fed a stretch of rows at a time.

    Parameters
    ----------
    switching : InteractingModels
        The modes, in steps.
    causal : bool
        Whether to filter (True) or to smooth.
    judge : callable, optional
        Shown the innovations of each stretch, of the mixture of all modes.
    split : bool
        Whether to tell the share of each part of the component, and then the probability of each mode.
    tells_modes : bool
        Whether to tell the probabilities alone, where nothing is split.
    """

    def __init__(
        self,
        switching: InteractingModels,
        *,
        causal: bool,
        judge: Judge | None = None,
        split: bool = False,
        tells_modes: bool = False,
    ) -> None:
        self._causal = causal
        super().__init__(ForwardImm(switching, judge, split=split, tells_modes=tells_modes))
        self._group = _LEAST_GROUP if causal else _group_rows(switching)
        self._few = Rows.nothing()
        self._held: _Stretch | None = None

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return what can be told for good."""
        judged = self._filter.judged(z)
        if self._causal:
            return [self._take(Rows(judged.readings, elapsed, judged.verdicts))[1]]
        rows, told = Rows.joined([self._few, Rows(judged.readings, elapsed, judged.verdicts)]), list[EstimatedRows]()
        while len(rows.z) >= self._group:
            told += self._take_group(rows.part(slice(self._group)))
            rows = rows.part(slice(self._group, None))
        self._few = rows
        return told

    def finish(self) -> list[EstimatedRows]:
        """Say that no more rows will come; return what was waiting for them."""
        told = self._take_group(self._few) if len(self._few.z) else []
        self._few = Rows.nothing()
        if self._held is not None:
            told.append(self._smooth(self._held, nothing_later(self._held.bank)))
            self._held = None
        return told

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
        return _Stretch(bank, z, steps, before, verdicts), self._filter.told(trace, verdicts)

    def _smooth(self, stretch: _Stretch, later: Floats) -> EstimatedRows:
        """Come back over a stretch with what the rows after it say."""
        trace = self._filter.room(len(stretch.z))
        smooth_rows(stretch.bank, self._filter.state, stretch.z, stretch.steps, stretch.before, later, trace)
        return self._filter.told(trace, stretch.verdicts)


def _group_rows(switching: InteractingModels) -> int:
    """Return how many rows later the calmest mode has forgotten, in whole blocks."""
    models = [mode.component.to_model(1.0, mode.noise_variance) for mode in switching.modes]
    longest = max(rows_until(FORGOTTEN, model) for model in models)
    return max(_LEAST_GROUP, int(min(longest, _MOST_GROUP)) // BLOCK * BLOCK)
