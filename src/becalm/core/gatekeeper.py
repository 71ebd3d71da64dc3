"""The gate of a filter that is no channel in C: a fixed lag, or `Online`.

It decides which readings are missing, and where the signal jumps; the filter stays what it is. It then runs over
readings with NaN where there was a spike, and over a timeline whose step before a jump has a larger Q.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Codes, Floats, Integers
from becalm.core.gates import Gate, level_of
from becalm.core.kernel_gate import COUNTERS, Rule, find_outliers
from becalm.core.kernels import sizes_of
from becalm.core.model import Model
from becalm.core.timeline import Timeline
from becalm.core.verdict import Verdict
from becalm.errors import ModelError


class Gated(NamedTuple):
    """What a gate says of some rows."""

    verdicts: Codes  # (B,) USED, SPIKE or STEP; MISSING where no reading came
    rows: Integers  # (s,) where the signal jumps
    jumps: Floats  # (s, n) variances that the states gain there

    @property
    def rejects(self) -> bool:
        """Whether it changes anything."""
        return bool(len(self.rows) or np.any(self.verdicts == Verdict.SPIKE))

    def readings(self, z: Floats) -> Floats:
        """Return readings (B, 1) without the spikes."""
        return np.where((self.verdicts == Verdict.SPIKE)[:, np.newaxis], np.nan, z)

    def beside(self, verdicts: Codes) -> Codes:
        """Return what became of each reading (B,), given what was known of it before."""
        return np.where(self.verdicts >= Verdict.SPIKE, self.verdicts, verdicts)


class Gatekeeper:
    """Judges the rows of one channel by what a filter believed before them; remembers rejects from call to call.

    Parameters
    ----------
    model : Model
        Of one channel.
    gate : Gate
        When to reject.

    Attributes
    ----------
    counters : (6,) float array
        What is remembered from call to call, see `kernel_gate`.

    Raises
    ------
    ModelError
        If the model has more than one channel.
    """

    def __init__(self, model: Model, gate: Gate) -> None:
        if model.channels != 1:
            raise ModelError(f"A gate judges one channel; this model has {model.channels}. Leave the gate out.")
        self._sizes, self._states = sizes_of(model), model.states
        self._rule = Rule(gate.threshold, gate.agree, gate.at_most, level_of(model))
        self.counters = np.zeros(len(COUNTERS))

    def judge(self, timeline: Timeline, z: Floats, begun: int, belief: Floats) -> Gated:
        """Judge the rows of z (B, 1) from `begun` on.

        Parameters
        ----------
        timeline : Timeline
            The steps before the rows.
        z : (B, 1) float array
            Readings, NaN where missing.
        begun : int
            The first row to judge.
        belief : (n + n^2 or more,) float array
            Mean and covariance before it, as a filter's memory begins.

        Returns
        -------
        Gated
            Of all rows of z; those before `begun` are not judged.
        """
        n = self._states
        memory = np.concatenate([belief[: n + n * n], self.counters])
        verdicts = np.where(np.isnan(z[:, 0]), Verdict.MISSING, Verdict.USED).astype(np.int8)
        jumps = np.zeros((1 + len(z) - begun, n))  # perhaps one a row, where readings are wild
        record = timeline.record(z)
        found = find_outliers(self._sizes, timeline.system, record, begun, self._rule, memory, verdicts, jumps)
        self.counters = memory[n + n * n :]
        return Gated(verdicts, np.flatnonzero(verdicts == Verdict.STEP), jumps[:found])


def with_jumps(timeline: Timeline, rows: Integers, jumps: Floats) -> Timeline:
    """Return a timeline with steps of their own before some rows (s,), whose Q gains variances (s, n) of the states."""
    if not len(rows):
        return timeline
    first, step, F, Q = timeline.first, timeline.step, timeline.system.F, timeline.system.Q
    starts = np.union1d(first[:-1], np.concatenate([rows, rows + 1]))
    starts = starts[starts < first[-1]]
    follows = step[np.searchsorted(first, starts, side="right") - 1]
    before = step[np.searchsorted(first, rows, side="right") - 1]
    follows[np.searchsorted(starts, rows)] = len(F) + np.arange(len(rows))
    wider = Q[before] + jumps[:, :, np.newaxis] * np.eye(jumps.shape[1])
    return Timeline(
        timeline.system._replace(F=np.concatenate([F, F[before]]), Q=np.concatenate([Q, wider])),
        np.append(starts, first[-1]),
        follows,
        np.concatenate([timeline.lengths, np.full(len(rows), np.nan)]),
    )
