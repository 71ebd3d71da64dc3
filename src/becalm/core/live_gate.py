"""The gate of a live filter: the decisions of a file's, reading by reading."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.gatekeeper import Gated, Gatekeeper
from becalm.core.gates import Gate
from becalm.core.kernel_online import LiveKernels
from becalm.core.kernel_settling import rename_last_step
from becalm.core.model import Model
from becalm.core.possible import largest_beside
from becalm.core.timeline import even_timeline, model_system
from becalm.core.verdict import Verdict, judge


class LiveGate:
    """Runs blocks of readings of one channel through a gate and then through live kernels.

    Parameters
    ----------
    model : Model
        Of one channel.
    gate : Gate
        When to reject.

    Raises
    ------
    ModelError
        If the model has more than one channel.
    """

    def __init__(self, model: Model, gate: Gate) -> None:
        self._model, self._gate, self.keeper = model, gate, Gatekeeper(model, gate)
        self._largest = largest_beside(float(model.R[0, 0]))
        n = model.states
        system = model_system(model)
        size = sum(matrix.size for matrix in system) + 1
        self._Q = slice(-size + n * n, -size + 2 * n * n)  # of the array that holds all, before H, R and a flag
        self.verdicts: Codes = np.empty(0, np.int8)

    @property
    def counters(self) -> Floats:
        """What is remembered of rejects."""
        return self.keeper.counters

    @counters.setter
    def counters(self, counters: Floats) -> None:
        self.keeper.counters = counters

    def look(self, z: Floats) -> Floats:
        """Note what comes, z (B, 1), before it is judged; return it with NaN for what no sensor gives."""
        judged = judge(z[:, 0], self._largest)
        self.verdicts = judged.verdicts
        return judged.readings[:, np.newaxis]

    def note(self, gated: Gated) -> None:
        """Note what became of the rows that were looked at, where another filter takes them."""
        self.verdicts = gated.beside(self.verdicts)

    def run(self, kernels: LiveKernels, live: Floats, z: Floats, out: Floats) -> None:
        """Take the last rows that were looked at, z (B, 1); write signal and sigma to out, (2, B, 1)."""
        if not len(z):
            return
        own = self.verdicts[len(self.verdicts) - len(z) :]
        timeline = even_timeline(self._model, len(z), goes_on=live[-1] == 0.0)
        usable = np.where(own[:, np.newaxis] == Verdict.USED, z, np.nan)
        gated = self.keeper.judge(timeline, usable, 0, live)
        own[:] = gated.beside(own)
        z, at = gated.readings(usable), 0
        for row, jump in zip(gated.rows, gated.jumps, strict=True):
            _run(kernels, live, z, out, slice(at, row))
            self._jump(kernels, live, z, out, slice(row, row + 1), jump)
            at = row + 1
        _run(kernels, live, z, out, slice(at, len(z)))

    def _jump(  # noqa: PLR0913  (what is read, what moves, what is written)
        self, kernels: LiveKernels, live: Floats, z: Floats, out: Floats, rows: slice, jump: Floats
    ) -> None:
        """Take one row after a step of its own, with a larger Q."""
        n, Q = self._model.states, live[self._Q].copy()
        live[self._Q] += np.diag(jump).ravel()
        rename_last_step(live, n, 1, None)
        _run(kernels, live, z, out, rows)
        rename_last_step(live, n, 1, None)
        live[self._Q] = Q

    def saved(self) -> dict[str, Floats]:
        """Return what a snapshot holds of it."""
        gate = self._gate
        return {"gate": np.array([gate.threshold, gate.agree, gate.at_most]), "gate_counters": self.counters}


def saved_gate(arrays: Mapping[str, Floats]) -> Gate | None:
    """Return the gate of a snapshot, if it has one."""
    if "gate" not in arrays:
        return None
    threshold, agree, at_most = arrays["gate"].tolist()
    return Gate(threshold, int(agree), int(at_most))


def _run(kernels: LiveKernels, live: Floats, z: Floats, out: Floats, rows: slice) -> None:
    part = np.empty((2, rows.stop - rows.start, 1))
    kernels.run(live, z[rows].flatten(), part)
    out[:, rows] = part
