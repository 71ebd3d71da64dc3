"""A smoother of one channel of any length, in constant memory.

Rows are filtered forward in stretches of one length, counted from the first row, so that the bits are the same however
rows are pushed. A stretch is smoothed once so many later rows are there that all that could follow would change
nothing: how far back the last of them reach is measured, by coming back from there with two futures as different as
can be. The filter itself, its gate, and where it starts anew are `native/smoother.c`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from becalm.core.arrays import BLOCK, Codes, Floats, input_of
from becalm.core.filter.channel import Estimates, log_densities, parts_of
from becalm.core.filter.channel_settings import ChannelSettings, StepTable, packed_coefficients, packed_settings
from becalm.core.filter.gate import Gate
from becalm.core.model.components import Component
from becalm.core.model.magnitudes import largest_beside
from becalm.core.rows import EstimatedRows, Judge, Rows
from becalm.core.steady.steady_gain import FORGOTTEN, rows_until
from becalm.core.verdict import Verdict
from becalm.core.verdict import judge as judge_readings
from becalm.native import DETERMINED
from becalm.native.smoothers import ForwardPass, Smoother

_LONGEST = 1 << 14  # rows of a stretch
_MOST_NUMBERS = 1 << 21  # of the matrices of its steps, where each row has some of its own
_DIFFERENT = 1e14  # two futures this far apart ...
_SAME = 1e-12  # ... have come this close: then `FORGOTTEN`, squared, lies between
_STRETCHES = 4  # that are told at once, if more may wait
_FAR = 1 << 40  # rows


class _Stretch(NamedTuple):
    passed: ForwardPass
    found: Estimates
    verdicts: Codes  # (B,)
    known: bool  # whether the state after it is
    variances: Floats  # (n,) after it


class SmoothedFlow:
    """A smoother of one channel that is fed any rows at a time.

    Parameters
    ----------
    component : Component
        The signal's model, in steps.
    noise_variance : float
        R, in unit^2.
    judge : callable, optional
        Shown the innovations of each stretch.
    split : bool
        Whether to tell the share of each part of the component, disturbances among them, too.
    gate : Gate, optional
        What leaves spikes out, and follows steps, from the first reading after them on; by default every reading is
        believed.

    Attributes
    ----------
    log_likelihood : float
        Of the readings so far that were foretold.
    """

    def __init__(
        self,
        component: Component,
        noise_variance: float,
        *,
        judge: Judge | None = None,
        split: bool = False,
        gate: Gate | None = None,
    ) -> None:
        settings = ChannelSettings(component, noise_variance, gate=gate)
        self._component, self._variance, self._judge, self._split = component, noise_variance, judge, split
        self._model = component.to_model(1.0, noise_variance)
        coefficients = packed_coefficients(component, noise_variance, disturbed=settings.disturbed)
        self._smoother = Smoother(packed_settings(settings), coefficients)
        self._steps, self._largest = StepTable(component, nearest=False), largest_beside(noise_variance)
        states = self._model.states
        self._length = max(BLOCK, min(_LONGEST, _MOST_NUMBERS // states**2 // BLOCK * BLOCK))
        self._few, self._count = list[Rows](), 0  # rows that make no stretch yet
        self._wanted = self._length  # so many of them make one
        self._held: list[_Stretch] = []  # until what follows tells the future
        self._begun = False
        self._reach = 0  # rows that later rows are looked at across, once they are needed
        self.log_likelihood = 0.0

    @property
    def settled_row(self) -> int | None:
        """The first row with a settled gain."""
        row = int(self._smoother.state["settled_row"])
        return None if row < 0 else row

    @property
    def shares(self) -> dict[str, float]:
        """Share of the rows in each mode; empty, for there are no modes."""
        return {}

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return what can be told for good."""
        z, elapsed = input_of(z), input_of(elapsed)
        if len(z) and not self._begun:
            elapsed = np.concatenate([[1.0], elapsed[1:]])  # the first row comes when it is due
            self._begun = True
        judged = judge_readings(z, self._largest)
        readings, steps = judged.readings.copy(), elapsed.copy()  # a caller may write into its own
        self._few.append(Rows(readings, steps, judged.verdicts))
        self._count += len(z)
        told = list[EstimatedRows]()
        if self._count < self._wanted:
            return told
        rows, at = Rows.joined(self._few), 0
        while self._count >= self._wanted:
            left = self._filter(rows.part(slice(at, at + self._wanted)), ends=False)
            taken = self._wanted - len(left.z)
            at += taken
            self._count -= taken
            self._wanted = self._length if taken else 2 * self._wanted
            told += self._told_for_good()
        self._few = [rows.part(slice(at, None))]
        return told

    def finish(self) -> list[EstimatedRows]:
        """Say that no more rows will come; return what was waiting for them."""
        if self._count:
            self._filter(Rows.joined(self._few), ends=True)
        self._few, self._count = [], 0
        return self._smoothed(len(self._held), self._smoother.nothing())

    def begin_after(self, reading: float, readings: int, steps: float) -> None:
        """Say what went before: the first reading of all, how many came, and how many steps went by."""
        self._smoother.begin_after(reading, readings, steps)
        self._begun = readings > 0

    def _filter(self, rows: Rows, *, ends: bool) -> Rows:
        """Filter a stretch forward; return the rows that are not decided yet."""
        found = Estimates.room(len(rows.z), self._model.states if self._split else 0)
        steps = self._steps.before(rows.elapsed)
        passed = self._smoother.forward(ends=ends, **found.outputs(), **steps, z=rows.z, elapsed=rows.elapsed)
        taken, left = slice(passed.taken), rows.part(slice(passed.taken, None))
        if not passed.taken:
            return left
        innovation, deviation = found.innovation[taken], found.deviation[taken]
        self.log_likelihood += float(np.nansum(log_densities(innovation, deviation)))
        if self._judge is not None:
            self._judge(innovation, deviation)
        state, n = self._smoother.state, self._model.states
        known = bool(state["phase"] == DETERMINED)
        variances = state["P"][: n * n : n + 1].copy()
        self._held.append(_Stretch(passed, found, rows.verdicts[taken], known, variances))
        return left

    def _told_for_good(self) -> list[EstimatedRows]:
        """Tell the stretches whose future is known."""
        rows = np.array([stretch.passed.taken for stretch in self._held])
        if len(rows) < _STRETCHES:
            return []
        self._reach = self._reach or self._usual_reach
        after = rows[::-1].cumsum()[::-1] - rows  # each stretch
        if rows.sum() < self._reach + max(self._reach, _STRETCHES * self._length):  # so that looking back costs little
            return []
        cuts = [k for k, stretch in enumerate(self._held) if stretch.known and after[k] >= self._reach]
        if not cuts:
            return []
        future = self._future_of(self._held[cuts[-1] + 1 :])
        if future is None:
            self._reach *= 2
            return []
        self._reach = self._usual_reach
        return self._smoothed(cuts[-1] + 1, future)

    def _smoothed(self, count: int, future: NDArray[np.void]) -> list[EstimatedRows]:
        """Smooth the first stretches that are held, and let them go."""
        now, self._held = self._held[:count], self._held[count:]
        for stretch in reversed(now):
            self._smoother.backward(stretch.passed, future)
        return [self._told(stretch) for stretch in now]

    def _told(self, stretch: _Stretch) -> EstimatedRows:
        taken = slice(stretch.passed.taken)
        found = stretch.found.rows(taken)
        verdicts = np.where(found.verdict == Verdict.USED, stretch.verdicts, found.verdict)
        told = found._replace(verdict=verdicts).told()
        return told._replace(parts=parts_of(self._component, found)) if self._split else told

    def _future_of(self, later: Sequence[_Stretch]) -> NDArray[np.void] | None:
        """Return what all rows after a stretch say of its end; None if more of them are needed to know."""
        variances = [stretch.variances for stretch in later if stretch.known]
        if not variances:
            return None
        n, future, other = self._model.states, self._smoother.nothing(), self._smoother.nothing()
        other["M"][: n * n : n + 1] = _DIFFERENT / np.min(variances, axis=0)
        for one in (future, other):
            self._look_back(later, one)
        M, other_M = (one["M"][: n * n].reshape(n, n) for one in (future, other))
        scale = np.sqrt(np.diag(M))
        return future if np.all(np.abs(other_M - M) <= _SAME * np.outer(scale, scale)) else None

    def _look_back(self, later: Sequence[_Stretch], future: NDArray[np.void]) -> None:
        """Look at rows from so far ahead as later ones reach."""
        reach, parts = self._reach, list[tuple[_Stretch, int]]()
        for stretch in later:
            count = min(stretch.passed.taken, max(reach, 0))
            parts.append((stretch, count))
            reach -= count
        for stretch, count in reversed(parts):
            if count:
                self._smoother.look_back(stretch.passed, future, count)

    @cached_property
    def _usual_reach(self) -> int:
        """Rows after which a steady filter has forgotten where it came from, in whole blocks."""
        return BLOCK * (1 + int(min(rows_until(FORGOTTEN, self._model), _FAR) // BLOCK))
