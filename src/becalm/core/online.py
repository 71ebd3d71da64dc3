"""A streaming filter: it takes readings one by one or in blocks, and returns their estimates.

The block size changes no bit of the estimates. They agree with those of `kalman_filter` to 1e-12, except where
P0 is so wide or so ill conditioned that both filters lose digits.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from becalm.core.arrays import Codes, Floats
from becalm.core.filter.filtering import checked_readings, numbers, require_model
from becalm.core.filter.fixed_lag_flow import checked_lag
from becalm.core.filter.gate import Gate
from becalm.core.filter.online_channel import OnlineChannel
from becalm.core.filter.online_multivariate import OnlineMultivariate
from becalm.core.imm.live import LiveImm
from becalm.core.imm.live_fixed_lag import new_live_imm, restored_imm
from becalm.core.imm.modes import InteractingModels
from becalm.core.model.model import Model
from becalm.core.reading_verdicts import Verdict
from becalm.errors import ModelError

_VERSION = 4  # version of a snapshot
_NOT_A_SNAPSHOT = "These bytes are not a snapshot of becalm.Online; pass what snapshot() returned."


class Online:
    """A filter that takes readings as they arrive, and can be paused.

    Parameters
    ----------
    model : Model or InteractingModels
        Model of the signal and its sensors, one step per reading. Without x0 and P0 the filter starts from the
        first readings; until they determine the state, the signal is NaN and sigma inf. An IMM has one channel.
    lag : int
        Lag in readings: each estimate belongs to the reading `lag` steps earlier and uses all readings since then. The
        first `lag` estimates are NaN with sigma inf. A *small* lag gives estimates earlier and with more noise; 0 is
        the filter. An IMM uses at least three quarters of the readings within the lag.
    gate : Gate, optional
        Innovation gate, for a model of one channel: it rejects spikes and follows steps. By default every reading
        is used.

    Raises
    ------
    ModelError
        If the model or the gate has another type, the model cannot start without x0 and P0, the lag is not a whole
        number, or a gate is given for a model of several channels or for an IMM.
    """

    def __init__(self, model: Model | InteractingModels | LiveImm, lag: int = 0, gate: Gate | None = None) -> None:
        lag = checked_lag(lag)
        self._filter = _new_filter(model, lag, gate)
        self.model, self._lag, self._gate = self._filter.model, lag, gate
        self._quick: Callable[[float], tuple[float, float]] | None = None  # fast path for one number

    def step(self, z_k: ArrayLike) -> tuple[Floats, Floats] | tuple[float, float]:
        """Take one reading; return signal and sigma.

        Parameters
        ----------
        z_k : float or (m,) array_like
            The reading in the channels' units, NaN where a channel is missing. For a model of one channel it may be a
            number; signal and sigma are then numbers, too. Otherwise they are arrays, (m,) each.

        Raises
        ------
        ModelError
            If the reading is not m real numbers.
        """
        if isinstance(z_k, float):
            quick = self._quick or self._filter.stepper()
            if quick is not None:
                self._quick = quick
                return quick(z_k)
        row = np.ravel(numbers(z_k))
        if len(row) != self.model.channels:
            raise ModelError(f"z_k has {len(row)} values; this model has {self.model.channels} channels.")
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
        z = checked_readings(self.model, block)
        if self._lag:
            self._quick = None  # the fast path has its own copy of the waiting rows
        return self._filter.run(z)

    @property
    def modes(self) -> dict[str, float]:
        """Return the probability of each mode of an IMM after the last reading; empty for other filters."""
        return self._filter.modes if isinstance(self._filter, LiveImm) else {}

    @property
    def verdicts(self) -> Codes | None:
        """Return the `Verdict` of each reading of the last block, (B,), whatever the lag; None without a gate."""
        return self._filter.verdicts if isinstance(self._filter, OnlineChannel) and self._gate is not None else None

    @property
    def verdict(self) -> Verdict | None:
        """Return the verdict of the last reading; None without a gate, or before the first reading."""
        verdicts = self.verdicts
        return None if verdicts is None or not len(verdicts) else Verdict(int(verdicts[-1]))

    def finish(self) -> tuple[Floats, Floats]:
        """Return signal and sigma, (rows, m) each, of the last `lag` readings, estimated from all readings so far.

        The state does not change: more readings may follow.
        """
        return self._filter.finish()

    def snapshot(self) -> bytes:
        """Return the complete state as bytes, for `resume`."""
        arrays: dict[str, Any] = {"lag": np.array(self._lag)}
        for name in ("F", "H", "Q", "R", "G", "x0", "P0", "known"):
            value = getattr(self.model, name)
            if value is not None:
                arrays[f"model_{name}"] = value
        if self._gate is not None:
            arrays["gate"] = np.array([self._gate.threshold, self._gate.agree, self._gate.at_most])
        buffer = io.BytesIO()
        np.savez(buffer, version=np.array(_VERSION), **arrays, **self._filter.state_dict())
        return buffer.getvalue()

    def __reduce__(self) -> tuple[Callable[[bytes], Self], tuple[bytes]]:
        """Copy and pickle the filter by a snapshot; the copy does not have the verdicts of the last block."""
        return type(self).resume, (self.snapshot(),)

    @classmethod
    def resume(cls, blob: bytes) -> Self:
        """Return a filter that continues from a snapshot; its results equal those of a filter that never stopped.

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
            return cls._restored(arrays)
        except ModelError:
            raise
        except Exception as cause:  # damaged bytes raise many kinds of exceptions
            raise ModelError(_NOT_A_SNAPSHOT) from cause

    @classmethod
    def _restored(cls, arrays: dict[str, Any]) -> Self:
        model, gate = Model(**{name[6:]: a for name, a in arrays.items() if name.startswith("model_")}), None
        if "gate" in arrays:
            threshold, agree, at_most = arrays["gate"].tolist()
            gate = Gate(threshold, int(agree), int(at_most))
        imm = restored_imm(model, arrays)
        online = cls(imm or model, int(arrays["lag"]), gate)
        if not isinstance(online._filter, LiveImm):
            online._filter.load_state_dict(arrays)
        return online


def _new_filter(
    model: Model | InteractingModels | LiveImm, lag: int, gate: Gate | None
) -> LiveImm | OnlineChannel | OnlineMultivariate:
    """Return the streaming filter of a model."""
    if gate is not None and not isinstance(gate, Gate):
        raise ModelError(f"A Gate is needed; {type(gate).__name__} came. Make one: Gate(threshold).")
    if isinstance(model, InteractingModels | LiveImm):
        if gate is not None:
            raise ModelError("A filter with several modes finds outliers by its modes; leave the gate out.")
        return new_live_imm(model, lag) if isinstance(model, InteractingModels) else model
    require_model(model)
    if model.channels == 1:
        return OnlineChannel(model, lag, gate)
    if gate is not None:
        raise ModelError(f"A gate judges one channel; this model has {model.channels}. Leave the gate out.")
    return OnlineMultivariate(model, lag)
