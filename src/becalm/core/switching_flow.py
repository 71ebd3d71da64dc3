"""A channel of any length through a bank that switches, a stretch of rows at a time, in constant memory.

Causal, each stretch goes on from the beliefs after the one before. Smoothed, rows come in groups whose bounds
are counted from the start, so that cuts change no bit; a group is smoothed when the next one is complete, and
groups are so long that the calmest mode has forgotten, by then, what comes after.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import BLOCK, Codes, Floats, Integers
from becalm.core.kernel_switching import NOTHING_WANTED, note_length, switch_forward
from becalm.core.kernel_switching_ahead import outlook_length
from becalm.core.kernel_switching_return import switch_backward
from becalm.core.kernel_switching_row import Bank, memory_length
from becalm.core.steady import FORGOTTEN, steady
from becalm.core.switching import Switching, numbered_steps
from becalm.core.switching_filter import ByModes, SwitchingFilter, with_spikes
from becalm.core.told import Judge, Rows, Told
from becalm.errors import ModelError

_LEAST_GROUP = 64 * BLOCK
_MOST_GROUP = 1 << 22  # rows: a calmer mode than these tell is all but a constant


class _Stretch(NamedTuple):
    """Rows that were filtered, with what it takes to smooth them."""

    bank: Bank
    z: Floats  # (B,)
    steps: Integers  # (B,)
    memory: Floats  # (1 + blocks, K) beliefs after the stretch, then before each block
    verdicts: Codes  # (B,)


class SwitchingFlow(ByModes):
    """A filter, or a smoother, that switches, of one channel that is fed a stretch of rows at a time.

    Parameters
    ----------
    switching : Switching
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
        switching: Switching,
        *,
        causal: bool,
        judge: Judge | None = None,
        split: bool = False,
        tells_modes: bool = False,
    ) -> None:
        self._causal = causal
        super().__init__(SwitchingFilter(switching, judge, split=split, tells_modes=tells_modes))
        self._numbers = memory_length(switching.states, len(switching.modes))
        self._nothing_later = np.zeros(outlook_length(switching.states, len(switching.modes)))
        self._group = _LEAST_GROUP if causal else _group_rows(switching)
        self._few = Rows.nothing()
        self._held: _Stretch | None = None

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take the next rows, readings (B,) and the steps before them; return what can be told for good."""
        judged = self._filter.judged(z)
        if self._causal:
            return [self._take(Rows(judged.readings, elapsed, judged.verdicts))[1]]
        rows, told = Rows.joined([self._few, Rows(judged.readings, elapsed, judged.verdicts)]), list[Told]()
        while len(rows.z) >= self._group:
            told += self._take_group(rows.part(slice(self._group)))
            rows = rows.part(slice(self._group, None))
        self._few = rows
        return told

    def finish(self) -> list[Told]:
        """Say that no more rows will come; return what was waiting for them."""
        told = self._take_group(self._few) if len(self._few.z) else []
        self._few = Rows.nothing()
        if self._held is not None:
            told.append(self._smooth(self._held, self._nothing_later, -1)[0])
            self._held = None
        return told

    def _take_group(self, rows: Rows) -> list[Told]:
        """Filter a group, and smooth the one before it."""
        stretch, _ = self._take(rows)
        before, self._held = self._held, stretch
        if before is None:
            return []
        _, later = self._smooth(stretch, self._nothing_later, -1)
        return [self._smooth(before, later, int(stretch.steps[0]), stretch.bank)[0]]

    def _take(self, rows: Rows) -> tuple[_Stretch, Told]:
        z = self._filter.levelled(rows.z)
        lengths, steps = numbered_steps(rows.elapsed, goes_on=self._filter.rows > 0)
        bank = self.switching.bank(lengths)
        blocks = 0 if self._causal else -(-len(z) // BLOCK)
        memory = np.zeros((1 + blocks, self._numbers))
        trace = self._filter.run(z, bank, steps, memory)
        verdicts = with_spikes(rows.verdicts, trace)
        return _Stretch(bank, z, steps, memory, verdicts), self._filter.told(trace, verdicts)

    def _smooth(
        self, stretch: _Stretch, later: Floats, step_after: int, bank_after: Bank | None = None
    ) -> tuple[Told, Floats]:
        """Come back over a stretch from the beliefs of the row after it; return its rows, and those of its first."""
        trace = self._filter.room(len(stretch.z))
        sizes, later = self.switching.sizes, later.copy()
        for block in range(len(stretch.memory) - 2, -1, -1):
            rows = slice(block * BLOCK, min((block + 1) * BLOCK, len(stretch.z)))
            filtered = self._filtered_again(stretch, block, rows)
            bank = stretch.bank
            if rows.stop == len(stretch.z):
                steps = np.append(stretch.steps[rows], step_after)
                if bank_after is not None:  # the last row alone comes back over a step of the stretch after it
                    switch_backward(sizes, bank_after, steps[-2:], filtered[-1:], later, rows.stop - 1, trace)
                    steps, filtered = steps[:-1], filtered[:-1]
            else:
                steps = stretch.steps[rows.start : rows.stop + 1]
            switch_backward(sizes, bank, steps, filtered, later, rows.start, trace)
        return self._filter.told(trace, stretch.verdicts), later

    def _filtered_again(self, stretch: _Stretch, block: int, rows: slice) -> Floats:
        """Filter a block again from the beliefs before it; return those after each of its rows."""
        z, steps = stretch.z[rows], stretch.steps[rows]
        memory = np.zeros((1 + len(z), note_length(self.switching.states, len(self.switching.modes))))
        memory[0, : self._numbers] = stretch.memory[1 + block]
        switch_forward(self.switching.sizes, stretch.bank, z, steps, self.switching.start, memory, NOTHING_WANTED)
        return memory[1:]


def _group_rows(switching: Switching) -> int:
    """Return how many rows later the calmest mode has forgotten, in whole blocks."""
    longest = 0.0
    for mode in switching.modes:
        try:
            loop = steady(mode.component.to_model(1.0, mode.noise_variance)).closed_loop
            radius = float(np.abs(np.linalg.eigvals(loop)).max())
            rows = np.log(1 / FORGOTTEN) / -np.log(radius) if 0 < radius < 1 else _MOST_GROUP * float(radius >= 1)
        except ModelError:  # it never forgets
            rows = float(_MOST_GROUP)
        longest = max(longest, rows)
    return max(_LEAST_GROUP, int(min(longest, _MOST_GROUP)) // BLOCK * BLOCK)
