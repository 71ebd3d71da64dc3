"""Fixed-lag smoothing by interacting multiple models: estimate each row from at most L later rows.

The information of later readings on a mode has no forward recursion. So a backward pass over L rows or more runs after
every L/4 new rows. Each estimate uses at least three quarters of the L rows after it, and the cost is about four times
that of a smoother for any L. For each waiting row, the flow keeps the filtered states and the likelihoods of its
reading.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.filter.fixed_lag_flow import checked_lag
from becalm.core.imm.forward import ForwardImm, ImmFlowBase, with_spikes
from becalm.core.imm.modes import InteractingModels, numbered_steps
from becalm.core.rows import EstimatedRows, Judge
from becalm.errors import ModelError
from becalm.native.imm import ImmBuffers, ModeMatrices, State, Steps, note_size, smooth_late

_BACKWARD_PASSES = 4  # number of backward passes per lag
PIECE = 4096  # rows that are filtered at once


def rows_between(lag: int) -> int:
    """Return the number of rows between backward passes; a run that starts at a multiple of it has the same bits."""
    return max(1, (lag + 1) // _BACKWARD_PASSES)


class WaitingRows:
    """The filtered rows of an IMM that wait for later rows.

    Parameters
    ----------
    states, modes : int
        Number of states, and of modes.
    lag : int
        Lag in rows, 1 or more; with a *small* lag the signal comes earlier and has more noise.
    """

    def __init__(self, states: int, modes: int, lag: int) -> None:
        self.lag = lag
        self.every = rows_between(lag)  # number of rows between backward passes
        self.width = note_size(states, modes)  # K, number of floats in the note on a row
        self._notes = np.empty((0, self.width))
        self._turn = self.every  # number of waiting rows at which the next backward pass runs

    def __len__(self) -> int:
        """Return the number of waiting rows."""
        return len(self._notes)

    def take(self, notes: Floats, matrices: ModeMatrices, state: State, steps: Steps, buffers: ImmBuffers) -> int:
        """Take the next filtered rows; write the estimates of the rows that are due.

        Parameters
        ----------
        notes : (B, K) float array
            The notes on the new rows, which `filter_rows` wrote.
        matrices, steps : ModeMatrices, int array
            The matrices of the modes, and the index of the step before each waiting and each new row.
        state : () structured array
            The state after the new rows.
        buffers : ImmBuffers
            Output arrays for the waiting and the new rows; the first rows are written.

        Returns
        -------
        int
            Number of rows with estimates.
        """
        notes = np.vstack([self._notes, notes])
        if self._turn > len(notes):
            self._notes = notes
            return 0
        smooth_late(matrices, state, steps, notes, buffers, turn=self._turn, every=self.every, lag=self.lag)
        last = self._turn + (len(notes) - self._turn) // self.every * self.every
        due = max(0, last - 1 - self.lag + self.every)
        self._notes, self._turn = notes[due:].copy(), last + self.every - due
        return due

    def estimate_waiting(self, matrices: ModeMatrices, state: State, steps: Steps, buffers: ImmBuffers) -> None:
        """Write estimates of all waiting rows from the rows so far; the rows continue to wait."""
        count = len(self._notes)
        if count:
            smooth_late(matrices, state, steps, self._notes, buffers, turn=count, every=count, lag=count)

    def snapshot(self) -> dict[str, Floats]:
        """Return the state, as arrays."""
        return {"waiting_notes": self._notes, "waiting_turn": np.array(float(self._turn))}

    def load_state_dict(self, arrays: Mapping[str, Floats]) -> None:
        """Restore the result of `snapshot`; check shapes and types, because C does not.

        Raises
        ------
        ModelError
            If the arrays do not fit these modes and this lag.
        """
        notes, turn = arrays["waiting_notes"].copy(), float(arrays["waiting_turn"])
        fits = notes.ndim == 2 and notes.shape[1] == self.width and notes.dtype == np.float64
        if not fits or len(notes) > self.lag or not np.isfinite(notes).all() or turn not in range(1, self.lag + 2):
            raise ModelError("The snapshot's waiting rows do not fit its modes and lag; pass what snapshot() returned.")
        self._notes, self._turn = notes, int(turn)


class FixedLagImmFlow(ImmFlowBase):
    """A fixed-lag IMM smoother of one channel; a push may have any number of rows.

    Parameters
    ----------
    switching : InteractingModels
        The modes, in steps.
    lag : int
        Lag in rows, 1 or more, for any time between rows; a *small* lag leaves more noise.
    judge : callable, optional
        It receives the innovations of each push, for the mixture of all modes, and their standard deviations.
    split : bool
        Whether to return also the contribution of each part of the component, then the probability of each mode.
    with_probabilities : bool
        Whether to return the probabilities without the contributions; used only if `split` is False.

    Raises
    ------
    ModelError
        If the lag is not a whole number.
    """

    def __init__(
        self,
        switching: InteractingModels,
        *,
        lag: int,
        judge: Judge | None = None,
        split: bool = False,
        with_probabilities: bool = False,
    ) -> None:
        super().__init__(ForwardImm(switching, judge, split=split, with_probabilities=with_probabilities))
        self._waiting = WaitingRows(switching.states, len(switching.modes), checked_lag(lag))
        self._elapsed: Floats = np.empty(0)  # steps before the waiting rows
        self._verdicts: Codes = np.empty(0, np.int8)

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return the waiting rows that are now due."""
        judged, estimates = self._filter.judged(z), list[EstimatedRows]()
        for begin in range(0, len(z), PIECE):
            rows = slice(begin, begin + PIECE)
            estimates.append(self._take(judged.readings[rows], elapsed[rows], judged.verdicts[rows]))
        return estimates

    def finish(self) -> list[EstimatedRows]:
        """Return estimates of the waiting rows from the rows so far."""
        lengths, steps = numbered_steps(self._elapsed)
        buffers = self._filter.new_buffers(len(self._waiting))
        self._waiting.estimate_waiting(self.switching.matrices(lengths), self._filter.state, steps, buffers)
        return [self._filter.estimates_from(buffers, self._verdicts)]

    def state_dict(self) -> dict[str, Any]:
        """Return the state that later rows depend on, as arrays."""
        waiting = {"flow_elapsed": self._elapsed, "flow_verdicts": self._verdicts}
        return super().state_dict() | self._waiting.snapshot() | waiting

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`; raise a ModelError if it does not fit these modes and this lag."""
        super().load_state_dict(arrays)
        self._waiting.load_state_dict(arrays)
        self._elapsed, self._verdicts = arrays["flow_elapsed"], arrays["flow_verdicts"]

    def _take(self, z: Floats, elapsed: Floats, verdicts: Codes) -> EstimatedRows:
        elapsed, waited = np.concatenate([self._elapsed, elapsed]), len(self._waiting)
        lengths, steps = numbered_steps(elapsed)
        matrices, notes = self.switching.matrices(lengths), np.empty((len(z), self._waiting.width))
        filtered = self._filter.run(np.ascontiguousarray(z), matrices, steps[waited:], notes=notes)
        buffers = self._filter.new_buffers(len(elapsed))
        count = self._waiting.take(notes, matrices, self._filter.state, steps, buffers)
        verdicts = np.concatenate([self._verdicts, with_spikes(verdicts, filtered)])
        self._elapsed, self._verdicts = elapsed[count:], verdicts[count:]
        return self._filter.estimates_from(first_rows(buffers, count), verdicts[:count])


def first_rows(buffers: ImmBuffers, count: int) -> ImmBuffers:
    """Return the first `count` rows of each array."""
    return ImmBuffers(*(np.ascontiguousarray(array[..., :count]) for array in buffers))
