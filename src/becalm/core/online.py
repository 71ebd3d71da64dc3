"""One reading or one block in, the estimate out; the same numbers as `kalman_filter`, to the bit."""

from __future__ import annotations

import io
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Floats
from becalm.core.filtering import checked_readings, even_timeline, model_system, new_trace, run_filter
from becalm.core.kernel_steps import State, new_state
from becalm.core.kernels import Trace, forward
from becalm.core.model import Model
from becalm.errors import ModelError

_VERSION = 1
_NOT_A_SNAPSHOT = "These bytes are not a snapshot of becalm.Online; pass what snapshot() returned."
_MOVING = ("x", "P", "K", "L", "D", "checkpoint", "counters")


class Online:
    """A filter that is fed as readings come, and can be paused.

    Parameters
    ----------
    model : Model
        The signal and its sensors. Without x0 and P0 it starts from the first readings.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self._system = model_system(model)
        self._state: State | None = None
        self._fresh = True
        self._opening: Floats = np.empty((0, model.channels))
        if model.x0 is not None and model.P0 is not None:
            self._state = new_state(model.x0, model.P0, model.channels)

    def step(self, z_k: ArrayLike) -> tuple[Floats, Floats]:
        """Take one reading, (m,) or a number, NaN where a channel is missing; return signal and sigma, (m,) each."""
        row = np.asarray(z_k, dtype=np.float64).reshape(-1)
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
        held = len(self._opening)
        return self._open(np.vstack([self._opening, z]), held)

    def _open(self, z: Floats, held: int) -> tuple[Floats, Floats]:
        """Filter from the first reading on; until the state is known, the readings are kept."""
        run = run_filter(self.model, even_timeline(self.model, len(z)), z)
        if run.opening is not None and run.opening.known:
            self._state, self._fresh = run.state, False
            self._opening = self._opening[:0]
        else:
            read = np.isfinite(z).any(axis=1)
            self._opening = z[int(read.argmax()) :] if read.any() else z[:0]
        return run.estimate.signal[held:], run.estimate.sigma[held:]

    def _run(self, z: Floats, state: State) -> tuple[Floats, Floats]:
        which = np.zeros(len(z), dtype=np.int64)
        if self._fresh and len(z):
            which[0], self._fresh = -1, False
        full = new_trace(self.model, len(z), states=False, covariances=False)
        trace = Trace(
            full.signal, full.variance, full.innovation[:0], full.innovation_variance[:0], full.mean, full.cov
        )
        forward(self._system, which, z, state, trace)
        return trace.signal, np.sqrt(trace.variance)

    def snapshot(self) -> bytes:
        """Return all that is needed to go on later, as plain bytes."""
        arrays: dict[str, Floats] = {"opening": self._opening}
        for name in ("F", "H", "Q", "R", "G", "x0", "P0"):
            value = getattr(self.model, name)
            if value is not None:
                arrays[f"model_{name}"] = value
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
        self._fresh, opening = bool(arrays["fresh"]), arrays["opening"]
        _refuse_unlike("opening", opening, np.empty((len(opening), m)))
        self._opening = opening
        self._state = None
        if "state_x" in arrays:
            blank = new_state(np.zeros(n), np.zeros((n, n)), m)
            for name in _MOVING:
                _refuse_unlike(name, arrays[f"state_{name}"], getattr(blank, name))
            self._state = blank._replace(**{name: arrays[f"state_{name}"].copy() for name in _MOVING})


def _refuse_unlike(name: str, found: Floats, wanted: Floats) -> None:
    same = found.shape == wanted.shape and found.dtype == wanted.dtype
    if not same or (name != "opening" and not np.isfinite(found).all()):
        raise ModelError(f"{_NOT_A_SNAPSHOT} Its {name} is {found.dtype} of shape {found.shape}, or not finite.")
