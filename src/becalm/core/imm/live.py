"""Interacting multiple models for a live stream, with the methods that `Online` needs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.model import Model
from becalm.native.imm import NOTHING_WANTED, Bank, State, Stepper, filter_rows


class LiveImm:
    """A stream filter of interacting multiple models, one step per measurement.

    Parameters
    ----------
    model : Model
        The model of the mode with the most states, over one step.
    names : list of str
        The names of the modes.
    bank : Bank
        The modes, over one step.
    state : () structured array
        The state of the modes; it changes in place.
    """

    def __init__(self, model: Model, names: list[str], bank: Bank, state: State) -> None:
        self.model, self._names, self._bank, self._state = model, names, bank, state
        self.step: Callable[[float], tuple[float, float]] = Stepper(bank, state).step

    def run(self, z: Floats) -> tuple[Floats, Floats]:
        """Take a block, (B, 1); return signal and sigma, (B, 1) each."""
        trace = NOTHING_WANTED._replace(signal=np.full(len(z), np.nan), sigma=np.full(len(z), np.inf))
        filter_rows(self._bank, self._state, z.flatten(), np.zeros(len(z), np.int32), trace)
        return trace.signal[:, np.newaxis], trace.sigma[:, np.newaxis]

    def stepper(self) -> Callable[[float], tuple[float, float]]:
        """Return a fast function from one reading to signal and sigma."""
        return self.step

    def finish(self) -> tuple[Floats, Floats]:
        """Return signal and sigma of the waiting readings, (0, 1) each: there are none."""
        return np.empty((0, 1)), np.empty((0, 1))

    @property
    def modes(self) -> dict[str, float]:
        """Return the probability of each mode after the last reading; before the first, the initial one."""
        mu: Floats = self._state["mu"]
        probabilities = mu if mu[0] > 0 else self._bank.start[:, 0]
        return dict(zip(self._names, probabilities.tolist(), strict=True))

    def saved(self) -> dict[str, Any]:
        """Return modes and state as arrays; `restored_imm` takes them, with the model."""
        modes = {"bank_names": np.array(self._names), "bank_state": np.frombuffer(self._state.tobytes(), np.int8)}
        return modes | {f"bank_{name}": array for name, array in self._bank._asdict().items()}
