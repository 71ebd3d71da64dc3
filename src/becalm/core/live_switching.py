"""A live bank that switches: all that `Online` needs of it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.kernel_switching_online import (
    BELIEFS,
    live_bank_kernels,
    live_bank_length,
)
from becalm.core.model import Model
from becalm.core.switching import MOST_MODES
from becalm.errors import ModelError


class LiveSwitching:
    """Takes readings one step apart.

    Parameters
    ----------
    model : Model
        The richest mode's, over one step.
    names : list of str
        Of the modes.
    live : (live_bank_length(n, M),) float array
        All that the kernels need; it is changed in place.

    Raises
    ------
    ModelError
        If the array is not one of a bank of that many modes and states.
    """

    def __init__(self, model: Model, names: list[str], live: Floats) -> None:
        self.model, self._names, self._live = model, names, live
        fits = 1 <= len(names) <= MOST_MODES and live.shape == (live_bank_length(model.states, len(names)),)
        if not fits or live.dtype != np.float64 or not np.isfinite(live).all():
            raise ModelError(
                f"{len(names)} modes of {model.states} states do not fit {live.dtype} of {live.shape};"
                " pass what snapshot() returned."
            )
        self._kernels = live_bank_kernels(model.states, len(names))
        self._begins = live[-len(names) * (1 + model.states) :: 1 + model.states].copy()
        self.step: Callable[[float], tuple[float, float]] = partial(self._kernels.step, live)

    def run(self, z: Floats) -> tuple[Floats, Floats]:
        """Take a block, (B, 1); return signal and sigma, (B, 1) each."""
        out = np.empty((2, len(z), 1))
        self._kernels.run(self._live, z.flatten(), out)
        return out[0], out[1]

    def finish(self) -> tuple[Floats, Floats]:
        """Return signal and sigma, (rows, 1) each, of the readings that wait: none."""
        return np.empty((0, 1)), np.empty((0, 1))

    @property
    def modes(self) -> dict[str, float]:
        """How probable each mode is after the last reading; before the first, what was given."""
        mu = self._live[BELIEFS : BELIEFS + len(self._names)]
        return dict(zip(self._names, (mu if mu[0] > 0 else self._begins).tolist(), strict=True))

    def saved(self) -> dict[str, Any]:
        """Return what `saved_switching` needs, besides the model."""
        return {"bank_names": np.array(self._names), "bank_live": self._live}
