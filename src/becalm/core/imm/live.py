"""Interacting multiple models for a live stream, with the methods that `Online` needs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.model import Model
from becalm.native.imm import NO_BUFFERS, ModeMatrices, State, Stepper, filter_rows


class LiveImm:
    """A stream filter of interacting multiple models, one step per measurement.

    Parameters
    ----------
    model : Model
        The model of the mode with the most states, over one step.
    names : list of str
        The names of the modes.
    matrices : ModeMatrices
        The modes, over one step.
    state : () structured array
        The state of the modes; it changes in place.
    """

    def __init__(self, model: Model, names: list[str], matrices: ModeMatrices, state: State) -> None:
        self.model, self._names, self._matrices, self._state = model, names, matrices, state
        self.step: Callable[[float], tuple[float, float]] = Stepper(matrices, state).step

    def run(self, z: Floats) -> tuple[Floats, Floats]:
        """Take a block, (B, 1); return signal and sigma, (B, 1) each."""
        buffers = NO_BUFFERS._replace(signal=np.full(len(z), np.nan), sigma=np.full(len(z), np.inf))
        filter_rows(self._matrices, self._state, z.flatten(), np.zeros(len(z), np.int32), buffers)
        return buffers.signal[:, np.newaxis], buffers.sigma[:, np.newaxis]

    def stepper(self) -> Callable[[float], tuple[float, float]]:
        """Return a fast function from one reading to signal and sigma."""
        return self.step

    def finish(self) -> tuple[Floats, Floats]:
        """Return signal and sigma of the waiting readings, (0, 1) each, because a filter has no waiting readings."""
        return np.empty((0, 1)), np.empty((0, 1))

    @property
    def modes(self) -> dict[str, float]:
        """Return the probability of each mode after the last reading, or the initial one before the first reading."""
        mu: Floats = self._state["mu"]
        probabilities = mu if mu[0] > 0 else self._matrices.start[:, 0]
        return dict(zip(self._names, probabilities.tolist(), strict=True))

    def state_dict(self) -> dict[str, Any]:
        """Return modes and state as arrays, from which `restored_imm` restores the filter with its model."""
        modes = {"bank_names": np.array(self._names), "bank_state": np.frombuffer(self._state.tobytes(), np.int8)}
        return modes | {f"bank_{name}": array for name, array in self._matrices._asdict().items()}
