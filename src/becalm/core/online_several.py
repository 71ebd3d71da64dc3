"""A stream of several channels of a model, one step a reading."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filtering import sizes_of
from becalm.core.fixed_lag import FixedLag
from becalm.core.kernel_online import live_kernels, new_live
from becalm.core.model import Model
from becalm.core.starting import (
    Information,
    arrived,
    carry,
    estimable,
    is_determined,
    is_narrow,
    known_before,
    known_state,
    learn,
    refuse_singular,
    wide_prior,
)
from becalm.core.timeline import even_timeline, model_system
from becalm.errors import ModelError


class OnlineSeveral:
    """Takes readings one step apart; parameters as of `Online`.

    Raises
    ------
    ModelError
        If the model cannot start without x0 and P0.
    """

    verdicts = None  # there is no gate

    def __init__(self, model: Model, lag: int) -> None:
        self.model, self.lag = model, lag
        self._late = FixedLag(model, lag) if lag else None
        self._kernels = live_kernels(*sizes_of(model))
        self._live: Floats | None = None
        self._known: Information | None = None  # what the opening has gathered, once a reading came
        self._prior = wide_prior(model)
        if lag:
            return
        if model.x0 is not None and model.P0 is not None and self._prior is None:
            self._live = new_live(model, model.x0, model.P0, fresh=True)
        else:
            refuse_singular(model_system(model))

    def run(self, z: Floats) -> tuple[Floats, Floats]:
        """Take a block, (B, m); return signal and sigma, (B, m) each, of the readings a lag before them."""
        if self._late is not None:
            late = self._late.push(even_timeline(self.model, len(z), goes_on=self._late.waiting > 0), z)
            return late.signal.T, late.sigma.T
        if self._live is not None:
            return self._run(z, self._live)
        signal, sigma = np.empty(z.shape), np.empty(z.shape)
        for k, row in enumerate(z):
            signal[k], variance = self._gather(row)
            sigma[k] = np.sqrt(variance)
            if self._live is not None:
                signal[k + 1 :], sigma[k + 1 :] = self._run(z[k + 1 :], self._live)
                break
        return signal, sigma

    def stepper(self) -> Callable[[float], tuple[float, float]] | None:
        """Return nothing: readings are no numbers."""
        return None

    def finish(self) -> tuple[Floats, Floats]:
        """Return signal and sigma, (rows, m) each, of the readings that wait; nothing changes by it."""
        if self._late is None:
            return np.empty((0, self.model.channels)), np.empty((0, self.model.channels))
        signal, sigma = self._late.rest()
        return signal.T, sigma.T

    def saved(self) -> dict[str, Any]:
        """Return what moves, as arrays."""
        arrays: dict[str, Any] = {}
        if self._known is not None:
            arrays |= {"known_Y": self._known.Y, "known_y": self._known.y}
        if self._live is not None:
            arrays["live"] = self._live
        return arrays | ({} if self._late is None else self._late.snapshot())

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what moves, of the right shapes and types only: kernels trust them."""
        n = self.model.states
        self._live, self._known = None, None
        if self._late is not None:
            self._late.restore(arrays)
        if "known_Y" in arrays:
            self._known = Information(arrays["known_Y"], arrays["known_y"])
            _refuse_unlike("known_Y", self._known.Y, np.empty((n, n)))
            _refuse_unlike("known_y", self._known.y, np.empty(n))
        if "live" in arrays:
            _refuse_unlike("live", arrays["live"], new_live(self.model, np.zeros(n), np.zeros((n, n)), fresh=False))
            self._live = arrays["live"].copy()

    def _run(self, z: Floats, live: Floats) -> tuple[Floats, Floats]:
        out = np.empty((2, *z.shape))
        self._kernels.run(live, z.flatten(), out)
        return out[0], out[1]

    def _gather(self, row: Floats) -> tuple[Floats, Floats]:
        """Take one reading of the opening; return H x and its variance as far as they are known."""
        system = model_system(self.model)
        F, Q, H, R = system.F[0], system.Q[0], system.H, system.R
        if self._known is None:
            if self._prior is None and not arrived(row).any():
                return np.full(len(H), np.nan), np.full(len(H), np.inf)
            self._known = learn(self._prior or known_before(self.model), H, R, row)
        else:
            self._known = learn(carry(self._known, F, Q), H, R, row)
        narrow = self._prior is None or is_narrow(self._known, system)
        told = estimable(self._known, H)
        if narrow and is_determined(self._known.Y):
            self._live, self._known = new_live(self.model, *known_state(self._known), fresh=False), None
        return told


def _refuse_unlike(name: str, found: Floats, wanted: Floats) -> None:
    same = found.shape == wanted.shape and found.dtype == wanted.dtype
    if not same or not np.isfinite(found).all():
        raise ModelError(f"The snapshot's {name} is {found.dtype} of shape {found.shape}, or not finite.")
