"""Fixed-lag smoothing by interacting multiple models: each row is estimated once the L rows after it are there.

What later readings say to a mode has no recursion forward, so the way back is gone again, over L rows, each time
that a quarter of L came: a row then knows at least three quarters of the L rows after it, at four times the cost
of a smoother, for any L. Of each row that waits, the beliefs are kept, and what its reading said.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.filter.lag import checked_lag
from becalm.core.imm.forward import ByModes, ForwardImm, with_spikes
from becalm.core.imm.modes import InteractingModels, numbered_steps
from becalm.core.rows import EstimatedRows, Judge
from becalm.errors import ModelError
from becalm.native.imm import Bank, State, Steps, Trace, note_size, smooth_late

_WAYS_BACK = 4  # in the time of one lag
PIECE = 4096  # rows whose beliefs are kept at once


def rows_between(lag: int) -> int:
    """Return how many rows come between two ways back; a run over a part is the same where it begins at a multiple."""
    return max(1, (lag + 1) // _WAYS_BACK)


class WaitingRows:
    """The rows of a bank that were filtered and wait for those after them.

    Parameters
    ----------
    states, modes : int
        Of the bank.
    lag : int
        Rows that each waits for, 1 or more; with a *small* one the signal comes soon, and noisier.
    """

    def __init__(self, states: int, modes: int, lag: int) -> None:
        self.lag = lag
        self.every = rows_between(lag)
        self.width = note_size(states, modes)  # numbers that are kept of a row, K
        self._notes = np.empty((0, self.width))
        self._turn = self.every  # rows from the first that waits to the next from which the way back is gone

    def __len__(self) -> int:
        """Return how many rows wait."""
        return len(self._notes)

    def take(self, notes: Floats, bank: Bank, state: State, steps: Steps, room: Trace) -> int:
        """Take rows, (B, K), as `filter_rows` noted them; write what can be told, and return of how many rows.

        `bank` and `steps` are of all rows that wait, and then of these; `room` is for as many; `state` is after them.
        """
        notes = np.vstack([self._notes, notes])
        if self._turn > len(notes):
            self._notes = notes
            return 0
        smooth_late(bank, state, steps, notes, room, turn=self._turn, every=self.every, lag=self.lag)
        last = self._turn + (len(notes) - self._turn) // self.every * self.every
        told = max(0, last - 1 - self.lag + self.every)
        self._notes, self._turn = notes[told:].copy(), last + self.every - told
        return told

    def tell_all(self, bank: Bank, state: State, steps: Steps, room: Trace) -> None:
        """Write what is told of all rows that wait, by what there is after them; they go on waiting."""
        count = len(self._notes)
        if count:
            smooth_late(bank, state, steps, self._notes, room, turn=count, every=count, lag=count)

    def snapshot(self) -> dict[str, Floats]:
        """Return what moves, as arrays."""
        return {"waiting_notes": self._notes, "waiting_turn": np.array(float(self._turn))}

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Take over what moves, of the right shapes and types only: C trusts them.

        Raises
        ------
        ModelError
            If the arrays are not those of a snapshot of such a bank and lag.
        """
        notes, turn = arrays["waiting_notes"].copy(), float(arrays["waiting_turn"])
        fits = notes.ndim == 2 and notes.shape[1] == self.width and notes.dtype == np.float64
        if not fits or len(notes) > self.lag or not np.isfinite(notes).all() or turn not in range(1, self.lag + 2):
            raise ModelError("The snapshot's fixed lag is not that of its bank; pass what snapshot() returned.")
        self._notes, self._turn = notes, int(turn)


class FixedLagImmFlow(ByModes):
    """A fixed-lag smoother that switches, of one channel that is fed a stretch of rows at a time.

    Parameters
    ----------
    switching : InteractingModels
        The modes, in steps.
    lag : int
        Later rows that are waited for, 1 or more, however far apart; with a *small* one more noise is left.
    judge : callable, optional
        Shown the innovations of each stretch, of the mixture of all modes.
    split : bool
        Whether to tell the share of each part of the component, and then the probability of each mode.
    tells_modes : bool
        Whether to tell the probabilities alone, where nothing is split.

    Raises
    ------
    ModelError
        If the lag is no whole number.
    """

    def __init__(
        self,
        switching: InteractingModels,
        *,
        lag: int,
        judge: Judge | None = None,
        split: bool = False,
        tells_modes: bool = False,
    ) -> None:
        super().__init__(ForwardImm(switching, judge, split=split, tells_modes=tells_modes))
        self._waiting = WaitingRows(switching.states, len(switching.modes), checked_lag(lag))
        self._elapsed: Floats = np.empty(0)  # steps before the rows that wait
        self._verdicts: Codes = np.empty(0, np.int8)

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return those that have waited."""
        judged, told = self._filter.judged(z), list[EstimatedRows]()
        for begin in range(0, len(z), PIECE):
            rows = slice(begin, begin + PIECE)
            told.append(self._take(judged.readings[rows], elapsed[rows], judged.verdicts[rows]))
        return told

    def finish(self) -> list[EstimatedRows]:
        """Say that no more rows will come; return the last ones, with what there is after them."""
        lengths, steps = numbered_steps(self._elapsed)
        room = self._filter.room(len(self._waiting))
        self._waiting.tell_all(self.switching.bank(lengths), self._filter.state, steps, room)
        return [self._filter.told(room, self._verdicts)]

    def saved(self) -> dict[str, Any]:
        """Return what rows depend on, as arrays."""
        waiting = {"flow_elapsed": self._elapsed, "flow_verdicts": self._verdicts}
        return super().saved() | self._waiting.snapshot() | waiting

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned; raises a ModelError if it is not that of such a bank and lag."""
        super().restore(arrays)
        self._waiting.restore(arrays)
        self._elapsed, self._verdicts = arrays["flow_elapsed"], arrays["flow_verdicts"]

    def _take(self, z: Floats, elapsed: Floats, verdicts: Codes) -> EstimatedRows:
        elapsed, waited = np.concatenate([self._elapsed, elapsed]), len(self._waiting)
        lengths, steps = numbered_steps(elapsed)
        bank, notes = self.switching.bank(lengths), np.empty((len(z), self._waiting.width))
        trace = self._filter.run(np.ascontiguousarray(z), bank, steps[waited:], notes=notes)
        room = self._filter.room(len(elapsed))
        count = self._waiting.take(notes, bank, self._filter.state, steps, room)
        verdicts = np.concatenate([self._verdicts, with_spikes(verdicts, trace)])
        self._elapsed, self._verdicts = elapsed[count:], verdicts[count:]
        return self._filter.told(first_rows(room, count), verdicts[:count])


def first_rows(trace: Trace, count: int) -> Trace:
    """Return what is written of the first rows."""
    return Trace(*(np.ascontiguousarray(array[..., :count]) for array in trace))
