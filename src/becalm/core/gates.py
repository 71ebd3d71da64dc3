"""The gate of a filter of one channel: spikes are left out, steps are followed, and nothing is locked out.

A gate decides which readings are missing, and where the signal jumps; the filter stays what it is. It then
runs over readings with NaN where there was a spike, and over a timeline whose step before a jump has a larger Q.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from becalm.core.arrays import Codes, Floats, Integers
from becalm.core.filtering import Estimate, sizes_of
from becalm.core.kernel_gate import COUNTERS, REJECTED, SINCE, Rule, find_outliers
from becalm.core.model import Model
from becalm.core.timeline import Timeline
from becalm.core.verdict import AGREE, AT_MOST, Verdict
from becalm.errors import ModelError

LEAST_THRESHOLD = 4.0
"""Where readings are so few that a narrower gate would do: it would cost more good readings than bad ones."""


def threshold_for(false_alarms_per_hour: float, readings_per_second: float) -> float:
    """Return how many standard deviations an innovation may have, for so many good readings rejected an hour.

    Parameters
    ----------
    false_alarms_per_hour : float
        Of Gaussian noise; a *small* one trusts the readings.
    readings_per_second : float
        How often a reading is judged.

    Returns
    -------
    float
        Phi^-1(1 - p/2) with p false alarms a reading: 5.0 for one an hour at 500 Hz, 5.55 at 10 kHz; never
        less than 4.

    Raises
    ------
    ModelError
        If one of them is not a positive number.

    Examples
    --------
    >>> round(threshold_for(1.0, 10_000.0), 2)
    5.55
    """
    for name, value in (("false_alarms_per_hour", false_alarms_per_hour), ("readings_per_second", readings_per_second)):
        if not 0 < value < np.inf:
            raise ModelError(f"{name} = {value} is no rate; give a positive number.")
    share = false_alarms_per_hour / (3600 * readings_per_second)
    return max(LEAST_THRESHOLD, float(-ndtri(max(min(share, 1.0) / 2, np.finfo(float).tiny))))


@dataclass(frozen=True)
class Gate:
    """When a reading is not believed, and when it is after all.

    Attributes
    ----------
    threshold : float
        z: a reading whose innovation exceeds z of its standard deviations is a spike, and counts as missing;
        a *small* one trusts the model. `threshold_for` gives it for a rate of false alarms.
    agree : int
        So many rejects in a row that agree with each other, to z of their noise, are a step: it is followed.
        With a *small* one sooner, but spikes that agree by chance are followed too.
    at_most : int
        So many rejects in a row are believed whatever they are, so that nothing is locked out for ever; a *small*
        one trusts the readings.

    Raises
    ------
    ModelError
        If the threshold is not positive, or `agree` is less than 2 or more than `at_most`.
    """

    threshold: float
    agree: int = AGREE
    at_most: int = AT_MOST

    def __post_init__(self) -> None:
        """Refuse what is no gate."""
        if not 0 < self.threshold < np.inf:
            raise ModelError(f"threshold = {self.threshold} is no gate; give a positive number, as threshold_for does.")
        if not 2 <= self.agree <= self.at_most:
            raise ModelError(
                f"agree = {self.agree} and at_most = {self.at_most} came; 2 <= agree <= at_most is needed."
                f" Leave them out for {AGREE} and {AT_MOST}."
            )


class Gated(NamedTuple):
    """What a gate says of some rows."""

    verdicts: Codes  # (B,) USED, SPIKE or STEP; MISSING where no reading came
    rows: Integers  # (s,) where the signal jumps
    jumps: Floats  # (s, n) variances that the states gain there
    undecided: int  # the row from which on rejects may yet be taken back; -1 for none

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
    takes_back : bool
        Whether rejects that agreed count as used in the end, from the first of them on, as for a smoother.

    Attributes
    ----------
    counters : (7,) float array
        What is remembered from call to call, see `kernel_gate`.

    Raises
    ------
    ModelError
        If the model has more than one channel.
    """

    def __init__(self, model: Model, gate: Gate, *, takes_back: bool = False) -> None:
        if model.channels != 1:
            raise ModelError(f"A gate judges one channel; this model has {model.channels}. Leave the gate out.")
        self._sizes, self._states = sizes_of(model), model.states
        self._rule = Rule(gate.threshold, gate.agree, gate.at_most, level_of(model), takes_back)
        self.counters = np.zeros(len(COUNTERS))

    def suspects(self, found: Estimate) -> bool:
        """Whether rows that were filtered without a gate have to be judged; otherwise they count as used."""
        nu, sigma = found.innovations[:, 0], found.innovation_sigma[:, 0]
        waiting = self.counters[REJECTED] > 0 or self.counters[SINCE] < 0
        if waiting or bool(np.any(np.abs(nu) > self._rule.threshold * sigma)):
            return True
        self.counters[SINCE] += np.count_nonzero(np.isfinite(nu))
        return False

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
        found, undecided = find_outliers(
            self._sizes, timeline.system, record, begun, self._rule, memory, verdicts, jumps
        )
        self.counters = memory[n + n * n :]
        return Gated(verdicts, np.flatnonzero(verdicts == Verdict.STEP), jumps[:found], undecided)


def level_of(model: Model) -> int:
    """Return the state to which a jump adds: one that keeps whatever is added to it, and is read; -1 for none."""
    kept = np.all(np.eye(model.states) == model.F, axis=0) & (model.H[0] != 0)
    return int(kept.argmax()) if kept.any() else -1


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
