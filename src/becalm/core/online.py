"""One reading or one block in, the estimate out: the numbers of `kalman_filter` to 1e-12, for any blocks to the bit."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Codes, Floats
from becalm.core.filtering import checked_readings, numbers, sizes_of
from becalm.core.fixed_lag import FixedLag
from becalm.core.gates import Gate
from becalm.core.kernel_online import live_kernels, new_live
from becalm.core.lags import checked_lag
from becalm.core.live_gate import LiveGate, saved_gate
from becalm.core.live_switching import LiveSwitching
from becalm.core.live_switching_lag import new_live_switching, saved_switching
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
from becalm.core.switching import Switching
from becalm.core.timeline import even_timeline, model_system
from becalm.core.verdict import Verdict
from becalm.errors import ModelError

_VERSION = 4
_FLOAT64 = np.dtype(np.float64)
_NOT_A_SNAPSHOT = "These bytes are not a snapshot of becalm.Online; pass what snapshot() returned."


class Online:
    """A filter that is fed as readings come, and can be paused.

    Parameters
    ----------
    model : Model or Switching
        The signal and its sensors, one step a reading. Without x0 and P0 it starts from the first
        readings; until they tell, the signal is NaN and sigma inf. A bank that switches has one channel.
    lag : int
        Readings that each estimate waits for, and then knows: what comes back is the signal of the reading `lag`
        steps ago, NaN with sigma inf while there is none. With a *small* one it comes soon, and noisier; 0 filters.
        A bank's estimate knows at least three quarters of them.
    gate : Gate, optional
        What leaves spikes out, and follows steps, of a model of one channel; by default every reading is believed.

    Raises
    ------
    ModelError
        If the model cannot start without x0 and P0, the lag is no whole number, or the filter is to have a gate
        and more than one channel, or a gate and modes to switch between.
    """

    def __init__(self, model: Model | Switching | LiveSwitching, lag: int = 0, gate: Gate | None = None) -> None:
        self._bank: LiveSwitching | None = None
        if not isinstance(model, Model):
            if gate is not None:
                raise ModelError("A filter that switches tells wild readings by its modes; leave the gate out.")
            self._bank = new_live_switching(model, checked_lag(lag)) if isinstance(model, Switching) else model
            model, lag = self._bank.model, 0
        self.model = model
        self._guard = None if gate is None else LiveGate(model, gate)
        keeper = None if self._guard is None else self._guard.keeper
        self._late = FixedLag(model, lag, gate=keeper) if checked_lag(lag) else None
        self._kernels = live_kernels(*sizes_of(model))
        self._width = model.channels
        self._live: Floats | None = None
        self._quick: Callable[[float], tuple[float, float]] | None = None
        self._known: Information | None = None  # what the opening has gathered, once a reading came
        self._prior = wide_prior(model)
        if self._bank is not None:
            self._quick = self._bank.step
        elif self._late is not None:
            self._one = even_timeline(model, 1, goes_on=True)
        elif model.x0 is not None and model.P0 is not None and self._prior is None:
            self._begin(new_live(model, model.x0, model.P0, fresh=True))
        else:
            refuse_singular(model_system(model))

    def _begin(self, live: Floats) -> None:
        """Go on from a state that is known; a number to a model of one channel then takes the shortest way."""
        self._live, self._known = live, None
        if self.model.channels == 1 and self._guard is None:
            self._quick = partial(self._kernels.step, live)

    def step(self, z_k: ArrayLike) -> tuple[Floats, Floats] | tuple[float, float]:
        """Take one reading; return signal and sigma.

        Parameters
        ----------
        z_k : float or (m,) array_like
            The reading in the channels' units, NaN where one is missing. For a model of one channel
            a number will do, and two numbers come back; otherwise signal and sigma are (m,) each.

        Raises
        ------
        ModelError
            If the reading is not m real numbers.
        """
        if self._quick is not None and isinstance(z_k, float):
            return self._quick(z_k)
        row = np.ravel(z_k)
        if len(row) != self.model.channels:
            raise ModelError(f"z_k has {len(row)} values; this model has {self.model.channels} channels.")
        if self._late is not None and self._late.waiting and self._guard is None:
            signal, sigma = (told[np.newaxis] for told in self._late.step(self._one, numbers(row)))
        else:
            signal, sigma = self.run(row[np.newaxis])
        if np.ndim(z_k) == 0:
            return float(signal[0, 0]), float(sigma[0, 0])
        return signal[0], sigma[0]

    def run(self, block: ArrayLike) -> tuple[Floats, Floats]:
        """Take a block of readings, (B,) or (B, m); return signal and sigma, (B, m) each.

        Raises
        ------
        ModelError
            If the block does not fit the model.
        """
        live, width = self._live, self._width
        if live is None or self._guard is not None or type(block) is not np.ndarray or block.dtype is not _FLOAT64:
            return self._run_any(block)
        if (block.ndim == 2 and block.shape[1] == width) or block.ndim == width == 1:
            out = np.empty((2, len(block), width))
            self._kernels.run(live, block.flatten(), out)  # a copy: kernels know one kind of array
            return out[0], out[1]
        return self._run_any(block)

    def _run_any(self, block: ArrayLike) -> tuple[Floats, Floats]:
        """Take a block of any kind, perhaps while nothing is known yet."""
        z = checked_readings(self.model, block)
        if self._bank is not None:
            return self._bank.run(z)
        if self._guard is not None:
            z = self._guard.look(z)
        if self._late is not None:
            late = self._late.push(even_timeline(self.model, len(z), goes_on=self._late.waiting > 0), z)
            if self._guard is not None and late.gated is not None:
                self._guard.note(late.gated)
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

    def _run(self, z: Floats, live: Floats) -> tuple[Floats, Floats]:
        out = np.empty((2, *z.shape))
        if self._guard is not None:
            self._guard.run(self._kernels, live, z, out)
        else:
            self._kernels.run(live, z.flatten(), out)
        return out[0], out[1]

    @property
    def modes(self) -> dict[str, float]:
        """How probable each mode is after the last reading, of a filter that switches; otherwise empty."""
        return {} if self._bank is None else self._bank.modes

    @property
    def verdicts(self) -> Codes | None:
        """What became of each reading of the last block, (B,), values of `Verdict`, no lag; None without a gate."""
        return None if self._guard is None else self._guard.verdicts

    @property
    def verdict(self) -> Verdict | None:
        """What became of the last reading; None without a gate, or before the first."""
        verdicts = self.verdicts
        return None if verdicts is None or not len(verdicts) else Verdict(int(verdicts[-1]))

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
            self._begin(new_live(self.model, *known_state(self._known), fresh=False))
        return told

    def finish(self) -> tuple[Floats, Floats]:
        """Return signal and sigma, (rows, m) each, of the last `lag` readings, with what there is after each.

        Nothing changes by it: more readings may follow.
        """
        if self._bank is not None:
            return self._bank.finish()
        if self._late is None:
            return np.empty((0, self._width)), np.empty((0, self._width))
        signal, sigma = self._late.rest()
        return signal.T, sigma.T

    def snapshot(self) -> bytes:
        """Return all that is needed to go on later, as plain bytes."""
        arrays: dict[str, Floats] = {}
        for name in ("F", "H", "Q", "R", "G", "x0", "P0", "known"):
            value = getattr(self.model, name)
            if value is not None:
                arrays[f"model_{name}"] = value
        if self._bank is not None:
            arrays |= self._bank.saved()
        if self._known is not None:
            arrays |= {"known_Y": self._known.Y, "known_y": self._known.y}
        if self._live is not None:
            arrays["live"] = self._live
        if self._guard is not None:
            arrays |= self._guard.saved()
        if self._late is not None:
            arrays |= {"lag": np.array(self._late.lag)} | self._late.snapshot()
        buffer = io.BytesIO()
        np.savez(buffer, version=np.array(_VERSION), **arrays)  # type: ignore[arg-type]
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
            model = Model(**{name[6:]: a for name, a in arrays.items() if name.startswith("model_")})
            bank = saved_switching(model, arrays)
            online = cls(bank or model, 0 if bank else int(arrays.get("lag", np.array(0))), saved_gate(arrays))
            if bank is None:
                online._restore(arrays)
        except ModelError:
            raise
        except Exception as cause:  # damaged bytes make the reader fail in many ways
            raise ModelError(_NOT_A_SNAPSHOT) from cause
        return online

    def _restore(self, arrays: dict[str, Floats]) -> None:
        """Take over what moves, of the right shapes and types only: kernels trust them."""
        n = self.model.states
        blank = new_live(self.model, np.zeros(n), np.zeros((n, n)), fresh=False)
        self._live, self._quick, self._known = None, None, None
        if self._late is not None:
            self._late.restore(arrays)
        if "known_Y" in arrays:
            self._known = Information(arrays["known_Y"], arrays["known_y"])
            _refuse_unlike("known_Y", self._known.Y, np.empty((n, n)))
            _refuse_unlike("known_y", self._known.y, np.empty(n))
        if "live" in arrays:
            _refuse_unlike("live", arrays["live"], blank)
            self._begin(arrays["live"].copy())
        if self._guard is not None:
            _refuse_unlike("gate_counters", arrays["gate_counters"], self._guard.counters)
            self._guard.counters = arrays["gate_counters"].copy()


def _refuse_unlike(name: str, found: Floats, wanted: Floats) -> None:
    same = found.shape == wanted.shape and found.dtype == wanted.dtype
    if not same or not np.isfinite(found).all():
        raise ModelError(f"{_NOT_A_SNAPSHOT} Its {name} is {found.dtype} of shape {found.shape}, or not finite.")
