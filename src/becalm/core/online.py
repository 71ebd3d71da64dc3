"""One reading or one block in, the estimate out; the same numbers as `kalman_filter`, to the bit."""

from __future__ import annotations

import io
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats, read_only
from becalm.core.filtering import checked_readings, model_system, new_trace
from becalm.core.kernel_steps import State, new_state
from becalm.core.kernels import Trace, forward
from becalm.core.model import Model
from becalm.core.starting import (
    Information,
    carry,
    estimable,
    is_determined,
    is_narrow,
    known_state,
    learn,
    nothing_known,
    refuse_singular,
    wide_prior,
)
from becalm.errors import ModelError

_VERSION = 1
_NOT_A_SNAPSHOT = "These bytes are not a snapshot of becalm.Online; pass what snapshot() returned."
_MOVING = ("x", "P", "K", "L", "D", "checkpoint", "counters")


class Online:
    """A filter that is fed as readings come, and can be paused.

    Parameters
    ----------
    model : Model
        The signal and its sensors, one step a reading. Without x0 and P0 it starts from the first
        readings; until they tell, the signal is NaN and sigma inf.

    Raises
    ------
    ModelError
        If the model cannot start without x0 and P0.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._system = model_system(model)
        self._state: State | None = None
        self._fresh = True
        self._known: Information | None = None  # what the opening has gathered, once a reading came
        self._prior = wide_prior(model)
        if model.x0 is not None and model.P0 is not None and self._prior is None:
            self._state = new_state(model.x0, model.P0, model.channels)
        else:
            refuse_singular(self._system)

    def step(self, z_k: ArrayLike) -> tuple[Floats, Floats]:
        """Take one reading, (m,) or a number, NaN where a channel is missing; return signal and sigma, (m,) each.

        Raises
        ------
        ModelError
            If the reading is not m real numbers.
        """
        row = np.ravel(z_k)
        if len(row) != self.model.channels:
            raise ModelError(f"z_k has {len(row)} values; this model has {self.model.channels} channels.")
        signal, sigma = self.run(row[np.newaxis])
        return signal[0], sigma[0]

    def run(self, block: ArrayLike) -> tuple[Floats, Floats]:
        """Take a block of readings, (B,) or (B, m); return signal and sigma, (B, m) each.

        Raises
        ------
        ModelError
            If the block does not fit the model.
        """
        z = checked_readings(self.model, block)
        if self._state is not None:
            return self._run(z, self._state)
        signal, sigma = np.full(z.shape, np.nan), np.full(z.shape, np.inf)
        for k, row in enumerate(z):
            signal[k], variance = self._gather(row)
            sigma[k] = np.sqrt(variance)
            if self._state is not None:
                signal[k + 1 :], sigma[k + 1 :] = self._run(z[k + 1 :], self._state)
                break
        return signal, sigma

    def _gather(self, row: Floats) -> tuple[Floats, Floats]:
        """Take one reading of the opening; return H x and its variance as far as they are known."""
        F, Q, H, R = self._system.F[0], self._system.Q[0], self._system.H, self._system.R
        if self._known is None:
            if self._prior is None and not np.isfinite(row).any():
                return np.full(len(H), np.nan), np.full(len(H), np.inf)
            self._known = learn(self._prior or nothing_known(self.model.unobservable), H, R, row)
        else:
            self._known = learn(carry(self._known, F, Q), H, R, row)
        narrow = self._prior is None or is_narrow(self._known, self._system)
        told = estimable(self._known, H)
        if narrow and is_determined(self._known.Y):
            self._state, self._known, self._fresh = new_state(*known_state(self._known), len(H)), None, False
        return told

    def _run(self, z: Floats, state: State) -> tuple[Floats, Floats]:
        which = np.zeros(len(z), dtype=np.int64)
        if self._fresh and len(z):
            which[0], self._fresh = -1, False
        full = new_trace(self.model, len(z), states=False, covariances=False)
        trace = Trace(
            full.signal, full.variance, full.innovation[:0], full.innovation_variance[:0], full.mean, full.cov
        )
        forward(self._system, read_only(which), read_only(z), state, trace)
        return trace.signal, np.sqrt(trace.variance)

    def snapshot(self) -> bytes:
        """Return all that is needed to go on later, as plain bytes."""
        arrays: dict[str, Floats] = {}
        for name in ("F", "H", "Q", "R", "G", "x0", "P0"):
            value = getattr(self.model, name)
            if value is not None:
                arrays[f"model_{name}"] = value
        if self._known is not None:
            arrays |= {"known_Y": self._known.Y, "known_y": self._known.y}
        if self._state is not None:
            arrays |= {f"state_{name}": getattr(self._state, name) for name in _MOVING}
        buffer = io.BytesIO()
        np.savez(buffer, version=np.array(_VERSION), fresh=np.array(self._fresh), **arrays)  # type: ignore[arg-type]
        return buffer.getvalue()

    @classmethod
    def resume(cls, blob: bytes) -> Self:
        """Go on from a snapshot; the results are those of a filter that was never stopped.

        Raises
        ------
        ModelError
            If the bytes are not a snapshot of this version.
        """
        try:
            with np.load(io.BytesIO(blob), allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
            if int(arrays["version"]) != _VERSION:
                raise ModelError(f"The snapshot has version {int(arrays['version'])}; this becalm reads {_VERSION}.")
            online = cls(Model(**{name[6:]: a for name, a in arrays.items() if name.startswith("model_")}))
            online._restore(arrays)
        except ModelError:
            raise
        except Exception as cause:  # damaged bytes make the reader fail in many ways
            raise ModelError(_NOT_A_SNAPSHOT) from cause
        return online

    def _restore(self, arrays: dict[str, Floats]) -> None:
        """Take over what moves, of the right shapes and types only: kernels trust them."""
        n, m = self.model.states, self.model.channels
        self._fresh, self._state, self._known = bool(arrays["fresh"]), None, None
        if "known_Y" in arrays:
            self._known = Information(arrays["known_Y"], arrays["known_y"])
            _refuse_unlike("known_Y", self._known.Y, np.empty((n, n)))
            _refuse_unlike("known_y", self._known.y, np.empty(n))
        if "state_x" in arrays:
            blank = new_state(np.zeros(n), np.zeros((n, n)), m)
            for name in _MOVING:
                _refuse_unlike(name, arrays[f"state_{name}"], getattr(blank, name))
            moving: dict[str, Any] = {name: arrays[f"state_{name}"].copy() for name in _MOVING}
            self._state = blank._replace(**moving)


def _refuse_unlike(name: str, found: Floats, wanted: Floats) -> None:
    same = found.shape == wanted.shape and found.dtype == wanted.dtype
    if not same or not np.isfinite(found).all():
        raise ModelError(f"{_NOT_A_SNAPSHOT} Its {name} is {found.dtype} of shape {found.shape}, or not finite.")
