"""Interacting multiple models for a live stream with a fixed lag; functions to make or restore an IMM of a stream."""

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
from becalm.native.imm import NO_BUFFERS, ImmBuffers, ModeMatrices, State, filter_rows, new_state, restored


class LiveFixedLagImm(LiveImm):
    """A fixed-lag smoother of interacting multiple models for a stream, one step per measurement.

    Parameters
    ----------
    model, names, matrices, state
        The parameters of `LiveImm`.
    lag : int
        Lag in readings, 1 or more; each estimate uses at least three quarters of the readings within it.
    """

    def __init__(self, model: Model, names: list[str], matrices: ModeMatrices, state: State, lag: int) -> None:
        super().__init__(model, names, matrices, state)
        self._waiting = WaitingRows(model.states, len(names), lag)
        self._rows_to_skip = lag  # first rows without an estimate: there is no row one lag earlier
        self._due = np.empty((2, 0))  # signal and sigma of rows that are smoothed but not due yet
        self.step = self._step

    def run(self, z: Floats) -> tuple[Floats, Floats]:
        """Take a block, (B, 1); return signal and sigma, (B, 1) each, of the readings one lag earlier."""
        out = np.full((2, len(z)), np.nan)
        out[1] = np.inf
        parts = [self._due, *(self._take(z[begin : begin + PIECE, 0]) for begin in range(0, len(z), PIECE))]
        due, early = np.hstack(parts), min(self._rows_to_skip, len(z))
        out[:, early:], self._due = due[:, : len(z) - early], due[:, len(z) - early :]
        self._rows_to_skip -= early
        return out[0, :, np.newaxis], out[1, :, np.newaxis]

    def finish(self) -> tuple[Floats, Floats]:
        """Return signal and sigma, (rows, 1) each, of the waiting readings, from the readings so far."""
        buffers = self._new_buffers(len(self._waiting))
        self._waiting.estimate_waiting(self._matrices, self._state, np.zeros(len(self._waiting), np.int32), buffers)
        signal, sigma = np.hstack([self._due, [buffers.signal, buffers.sigma]])
        return signal[:, np.newaxis], sigma[:, np.newaxis]

    def state_dict(self) -> dict[str, Any]:
        """Return modes and state as arrays, from which `restored_imm` restores the smoother with its model."""
        moves = {"waiting_due": self._due, "waiting_unwaited": np.array(float(self._rows_to_skip))}
        return super().state_dict() | self._waiting.snapshot() | moves

    def load_state_dict(self, arrays: Mapping[str, Floats]) -> None:
        """Restore the waiting rows; raise a ModelError if they do not fit these modes and this lag."""
        self._waiting.load_state_dict(arrays)
        due, rows_to_skip = arrays["waiting_due"].copy(), float(arrays["waiting_unwaited"])
        fits = due.ndim == 2 and len(due) == 2 and due.dtype == np.float64
        fits = fits and rows_to_skip in range(self._waiting.lag + 1)
        rows = self._waiting.lag - rows_to_skip  # number of rows without a returned estimate
        if not fits or due.shape[1] + len(self._waiting) != rows:
            raise ModelError("The snapshot's waiting rows do not fit its modes and lag; pass what snapshot() returned.")
        self._due, self._rows_to_skip = due, int(rows_to_skip)

    def _step(self, reading: float) -> tuple[float, float]:
        signal, sigma = self.run(np.array([[reading]]))
        return float(signal[0, 0]), float(sigma[0, 0])

    def _take(self, z: Floats) -> Floats:
        """Filter readings (B,); return signal and sigma, (2, rows), of the rows that are now smoothed."""
        steps = np.zeros(len(self._waiting) + len(z), np.int32)
        notes = np.empty((len(z), self._waiting.width))
        filter_rows(self._matrices, self._state, np.ascontiguousarray(z), steps[: len(z)], notes=notes)
        buffers = self._new_buffers(len(steps))
        count = self._waiting.take(notes, self._matrices, self._state, steps, buffers)
        return np.array([buffers.signal[:count], buffers.sigma[:count]])

    def _new_buffers(self, rows: int) -> ImmBuffers:
        return NO_BUFFERS._replace(signal=np.full(rows, np.nan), sigma=np.full(rows, np.inf))


def new_live_imm(switching: InteractingModels, lag: int) -> LiveImm:
    """Return a new live IMM filter, or a fixed-lag smoother if the lag is above 0."""
    matrices = switching.matrices(np.ones(1))
    state = new_state(matrices, keeps_level=switching.component.keeps_level)
    model = switching.component.to_model(1.0, switching.modes[0].noise_variance)
    names = [mode.name for mode in switching.modes]
    return LiveFixedLagImm(model, names, matrices, state, lag) if lag else LiveImm(model, names, matrices, state)


def restored_imm(model: Model, arrays: Mapping[str, Any]) -> LiveImm | None:
    """Return the live IMM of a snapshot; None if the snapshot has no modes.

    Raises
    ------
    ModelError
        If the arrays do not fit each other, or the model's number of states.
    """
    if "bank_state" not in arrays:
        return None
    names = arrays["bank_names"].tolist()
    matrices = ModeMatrices(*(arrays[f"bank_{name}"] for name in ModeMatrices._fields))
    fits = matrices.H.shape == (1, model.states) and len(names) == len(matrices.R) and len(matrices.T) == 1
    finite = all(np.isfinite(array).all() for array in matrices)
    state = restored(matrices, arrays["bank_state"]) if fits and finite else None
    if state is None:
        raise ModelError(
            f"{len(names)} modes of {model.states} states do not fit the state; pass what snapshot() returned."
        )
    lag = int(arrays["lag"])
    if not lag:
        return LiveImm(model, names, matrices, state)
    late = LiveFixedLagImm(model, names, matrices, state, lag)
    late.load_state_dict(arrays)
    return late
