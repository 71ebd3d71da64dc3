"""A live bank that switches with a fixed lag, and the doors to live banks of either kind."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.kernel_switching import NOTHING_WANTED, SwitchingTrace, switch_forward
from becalm.core.kernel_switching_online import (
    BELIEFS,
    KEEPS_LEVEL,
    LARGEST,
    LEVEL,
    LEVEL_KNOWN,
    live_bank,
    new_live_bank,
)
from becalm.core.kernel_switching_row import bank_sizes, memory_length
from becalm.core.live_switching import LiveSwitching
from becalm.core.model import Model
from becalm.core.possible import level_by
from becalm.core.starting import first_reading
from becalm.core.switching import Switching
from becalm.core.switching_lag import PIECE, WaitingRows
from becalm.errors import ModelError


class LateSwitching(LiveSwitching):
    """Takes readings one step apart, and tells each of them `lag` readings later.

    Parameters
    ----------
    model, names, live
        As of `LiveSwitching`.
    lag : int
        Readings that each estimate waits for, and of which it knows at least three quarters; 1 or more.

    Raises
    ------
    ModelError
        If the array is not one of a bank of that many modes and states.
    """

    def __init__(self, model: Model, names: list[str], live: Floats, lag: int) -> None:
        super().__init__(model, names, live)
        self._sizes = bank_sizes(model.states, len(names))
        self._bank, self._start = live_bank.py_func(self._sizes, live)  # type: ignore[attr-defined]
        self._beliefs = live[BELIEFS : BELIEFS + memory_length(model.states, len(names))]
        self._waiting = WaitingRows(self._sizes, lag)
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
        self._waiting.tell_all(self._bank, np.zeros(len(self._waiting), np.int64), room)
        signal, sigma = np.hstack([self._due, self._told(room, len(self._waiting))])
        return signal[:, np.newaxis], sigma[:, np.newaxis]

    def saved(self) -> dict[str, Any]:
        """Return what `saved_switching` needs, besides the model."""
        moves = {"waiting_due": self._due, "waiting_unwaited": np.array(float(self._unwaited))}
        return super().saved() | {"lag": np.array(self._waiting.lag)} | self._waiting.snapshot() | moves

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
        live = self._live
        z = np.where(np.abs(z) <= live[LARGEST], z, np.nan)
        if live[KEEPS_LEVEL] and not live[LEVEL_KNOWN] and (row := first_reading(z[:, np.newaxis])) < len(z):
            live[LEVEL_KNOWN], live[LEVEL] = 1.0, level_by(float(z[row]), float(self._bank.R.min()))
        steps = np.zeros(len(self._waiting) + len(z), np.int64)
        memory = np.zeros((1 + len(z), self._waiting.width))
        memory[0, : len(self._beliefs)] = self._beliefs
        level = np.ascontiguousarray(z - live[LEVEL])
        switch_forward(self._sizes, self._bank, level, steps[: len(z)], self._start, memory, NOTHING_WANTED)
        self._beliefs[:] = memory[0, : len(self._beliefs)]
        room = self._room(len(steps))
        return self._told(room, self._waiting.take(memory[1:], self._bank, steps, room))

    def _room(self, rows: int) -> SwitchingTrace:
        return NOTHING_WANTED._replace(signal=np.full(rows, np.nan), sigma=np.full(rows, np.inf))

    def _told(self, room: SwitchingTrace, count: int) -> Floats:
        return np.array([room.signal[:count] + self._live[LEVEL], room.sigma[:count]])


def new_live_switching(switching: Switching, lag: int) -> LiveSwitching:
    """Make a live bank that has read nothing yet."""
    live = new_live_bank(switching.bank(np.ones(1)), switching.start, keeps_level=switching.component.keeps_level)
    model = switching.component.to_model(1.0, switching.modes[0].noise_variance)
    names = [mode.name for mode in switching.modes]
    return LateSwitching(model, names, live, lag) if lag else LiveSwitching(model, names, live)


def saved_switching(model: Model, arrays: Mapping[str, Any]) -> LiveSwitching | None:
    """Return the bank of a snapshot; None where there is none."""
    if "bank_live" not in arrays:
        return None
    names, live = [str(name) for name in arrays["bank_names"]], arrays["bank_live"].copy()
    if "lag" not in arrays:
        return LiveSwitching(model, names, live)
    late = LateSwitching(model, names, live, int(arrays["lag"]))
    late.restore(arrays)
    return late
