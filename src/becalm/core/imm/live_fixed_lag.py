"""Interacting multiple models, live, with a fixed lag; and the doors to live ones of either kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.imm.fixed_lag_flow import PIECE, WaitingRows
from becalm.core.imm.live import LiveImm
from becalm.core.imm.modes import InteractingModels
from becalm.core.model.model import Model
from becalm.errors import ModelError
from becalm.native.imm import NOTHING_WANTED, Bank, State, Trace, filter_rows, new_state, restored


class LiveFixedLagImm(LiveImm):
    """Takes readings one step apart, and tells each of them `lag` readings later.

    Parameters
    ----------
    model, names, bank, state
        As of `LiveImm`.
    lag : int
        Readings that each estimate waits for, and of which it knows at least three quarters; 1 or more.
    """

    def __init__(self, model: Model, names: list[str], bank: Bank, state: State, lag: int) -> None:
        super().__init__(model, names, bank, state)
        self._waiting = WaitingRows(model.states, len(names), lag)
        self._unwaited = lag  # rows at the start that come with none so long before them
        self._due = np.empty((2, 0))  # signal and sigma that were told, and are asked for later
        self.step = self._step

    def run(self, z: Floats) -> tuple[Floats, Floats]:
        """Take a block, (B, 1); return signal and sigma, (B, 1) each, of the readings `lag` before them."""
        out = np.full((2, len(z)), np.nan)
        out[1] = np.inf
        told = [self._due, *(self._take(z[begin : begin + PIECE, 0]) for begin in range(0, len(z), PIECE))]
        due, early = np.hstack(told), min(self._unwaited, len(z))
        out[:, early:], self._due = due[:, : len(z) - early], due[:, len(z) - early :]
        self._unwaited -= early
        return out[0, :, np.newaxis], out[1, :, np.newaxis]

    def finish(self) -> tuple[Floats, Floats]:
        """Return signal and sigma, (rows, 1) each, of the readings that wait, with what there is after them."""
        room = self._room(len(self._waiting))
        self._waiting.tell_all(self._bank, self._state, np.zeros(len(self._waiting), np.int32), room)
        signal, sigma = np.hstack([self._due, [room.signal, room.sigma]])
        return signal[:, np.newaxis], sigma[:, np.newaxis]

    def saved(self) -> dict[str, Any]:
        """Return what `restored_imm` needs, besides the model."""
        moves = {"waiting_due": self._due, "waiting_unwaited": np.array(float(self._unwaited))}
        return super().saved() | self._waiting.snapshot() | moves

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Take over what waits; raises a ModelError if it is not that of such a bank and lag."""
        self._waiting.restore(arrays)
        due, unwaited = arrays["waiting_due"].copy(), float(arrays["waiting_unwaited"])
        whole = due.ndim == 2 and len(due) == 2 and due.dtype == np.float64 and unwaited in range(self._waiting.lag + 1)
        rows = self._waiting.lag - unwaited  # that came, and were not asked for
        if not whole or due.shape[1] + len(self._waiting) != rows:
            raise ModelError("The snapshot's fixed lag is not that of its bank; pass what snapshot() returned.")
        self._due, self._unwaited = due, int(unwaited)

    def _step(self, reading: float) -> tuple[float, float]:
        signal, sigma = self.run(np.array([[reading]]))
        return float(signal[0, 0]), float(sigma[0, 0])

    def _take(self, z: Floats) -> Floats:
        """Filter readings (B,); return signal and sigma of those that have waited, (2, rows)."""
        steps = np.zeros(len(self._waiting) + len(z), np.int32)
        notes = np.empty((len(z), self._waiting.width))
        filter_rows(self._bank, self._state, np.ascontiguousarray(z), steps[: len(z)], notes=notes)
        room = self._room(len(steps))
        count = self._waiting.take(notes, self._bank, self._state, steps, room)
        return np.array([room.signal[:count], room.sigma[:count]])

    def _room(self, rows: int) -> Trace:
        return NOTHING_WANTED._replace(signal=np.full(rows, np.nan), sigma=np.full(rows, np.inf))


def new_live_imm(switching: InteractingModels, lag: int) -> LiveImm:
    """Make a live bank that has read nothing yet."""
    bank = switching.bank(np.ones(1))
    state = new_state(bank, keeps_level=switching.component.keeps_level)
    model = switching.component.to_model(1.0, switching.modes[0].noise_variance)
    names = [mode.name for mode in switching.modes]
    return LiveFixedLagImm(model, names, bank, state, lag) if lag else LiveImm(model, names, bank, state)


def restored_imm(model: Model, arrays: Mapping[str, Any]) -> LiveImm | None:
    """Return the bank of a snapshot; None where there is none.

    Raises
    ------
    ModelError
        If the arrays are not those of a bank of the model's states.
    """
    if "bank_state" not in arrays:
        return None
    names, bank = arrays["bank_names"].tolist(), Bank(*(arrays[f"bank_{name}"] for name in Bank._fields))
    fits = bank.H.shape == (1, model.states) and len(names) == len(bank.R) and len(bank.T) == 1
    finite = all(np.isfinite(array).all() for array in bank)
    state = restored(bank, arrays["bank_state"]) if fits and finite else None
    if state is None:
        raise ModelError(
            f"{len(names)} modes of {model.states} states do not fit the state; pass what snapshot() returned."
        )
    lag = int(arrays["lag"])
    if not lag:
        return LiveImm(model, names, bank, state)
    late = LiveFixedLagImm(model, names, bank, state, lag)
    late.restore(arrays)
    return late
