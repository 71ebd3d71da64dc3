"""Smooth one channel of any length in constant memory.

The forward pass filters stretches with a fixed number of rows, counted from the first row, so that the boundaries
between pushes change no bit. A stretch is smoothed once so many later rows are there that further rows cannot change
the result. To test this, two backward passes start at a later row, one without information on the state there and one
with nearly full information. They must agree at the end of the stretch. The filter, its gate and its restarts are in
`native/smoother.c`.
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
from becalm.core.model.parts import largest_magnitude_for_noise
from becalm.core.reading_verdicts import Verdict
from becalm.core.reading_verdicts import judge as judge_readings
from becalm.core.rows import EstimatedRows, Judge, Rows
from becalm.core.steady.steady_filter import NEGLIGIBLE_SHARE, rows_until_decayed
from becalm.native import DETERMINED
from becalm.native.smoothers import ForwardPass, Smoother

_LONGEST = 1 << 14  # largest number of rows in a stretch
_MOST_NUMBERS = 1 << 21  # numbers in a stretch's step matrices, if each row has its own
_DIFFERENT = 1e14  # information with which the second backward pass starts, over that of the forward pass
_SAME = 1e-12  # largest relative difference of the passes; _SAME / _DIFFERENT is `NEGLIGIBLE_SHARE` squared
_STRETCHES = 4  # least number of stretches that wait before a backward pass
_FAR = 1 << 40  # rows; it replaces an infinite memory of the filter


class _Stretch(NamedTuple):
    forward_pass: ForwardPass
    estimates: Estimates
    verdicts: Codes  # (B,)
    determined: bool  # whether the measurements determine the state after the stretch
    variances: Floats  # (n,) variances of the state after the stretch


class SmoothedFlow:
    """A smoother of one channel; a push may have any number of rows.

    Parameters
    ----------
    component : Component
        The signal's model, in steps.
    noise_variance : float
        R, in unit^2.
    judge : callable, optional
        It receives the innovations of each stretch, and their expected standard deviations.
    split : bool
        Whether to return also the contribution of each part of the component, including disturbances.
    gate : Gate, optional
        The innovation gate: it rejects spikes, and follows a step from the first reading after it. By default every
        reading is used.

    Attributes
    ----------
    log_likelihood : float
        Log-likelihood of all readings so far for which there was a prediction.
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
        self._steps, self._largest = StepTable(component, nearest=False), largest_magnitude_for_noise(noise_variance)
        states = self._model.states
        self._length = max(BLOCK, min(_LONGEST, _MOST_NUMBERS // states**2 // BLOCK * BLOCK))
        self._incomplete, self._count = list[Rows](), 0  # rows of an incomplete stretch, and their number
        self._wanted = self._length  # rows that complete the stretch
        self._held: list[_Stretch] = []  # filtered stretches that wait for later rows
        self._has_rows = False
        self._reach = 0  # rows after a stretch that a test of the future passes back over; 0 until the first test
        self.log_likelihood = 0.0

    @property
    def settled_row(self) -> int | None:
        """Return the first row with the steady-state gain; None if there is none yet."""
        row = int(self._smoother.state["settled_row"])
        return None if row < 0 else row

    @property
    def shares(self) -> dict[str, float]:
        """Return the share of the rows in each mode: empty, because there are no modes."""
        return {}

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return the rows whose estimates are final."""
        z, elapsed = input_of(z), input_of(elapsed)
        if len(z) and not self._has_rows:
            elapsed = np.concatenate([[1.0], elapsed[1:]])  # the first row is on time
            self._has_rows = True
        judged = judge_readings(z, self._largest)
        readings, steps = judged.readings.copy(), elapsed.copy()  # the caller may overwrite its own arrays
        self._incomplete.append(Rows(readings, steps, judged.verdicts))
        self._count += len(z)
        output = list[EstimatedRows]()
        if self._count < self._wanted:
            return output
        rows, at = Rows.joined(self._incomplete), 0
        while self._count >= self._wanted:
            left = self._filter(rows.part(slice(at, at + self._wanted)), ends=False)
            taken = self._wanted - len(left.z)
            at += taken
            self._count -= taken
            self._wanted = self._length if taken else 2 * self._wanted
            output += self._final_rows()
        self._incomplete = [rows.part(slice(at, None))]
        return output

    def finish(self) -> list[EstimatedRows]:
        """End the record; return the rows that were waiting."""
        if self._count:
            self._filter(Rows.joined(self._incomplete), ends=True)
        self._incomplete, self._count = [], 0
        return self._smoothed(len(self._held), self._smoother.no_later_rows())

    def set_history(self, reading: float, readings: int, steps: float) -> None:
        """Set the history before the first row: the record's first reading, the number of readings, and of steps."""
        self._smoother.set_history(reading, readings, steps)
        self._has_rows = readings > 0

    def _filter(self, rows: Rows, *, ends: bool) -> Rows:
        """Filter a stretch forward; return its last rows if the gate cannot decide on them yet."""
        estimates = Estimates.allocate(len(rows.z), self._model.states if self._split else 0)
        steps = self._steps.before(rows.elapsed)
        forward = self._smoother.forward(ends=ends, **estimates.outputs(), **steps, z=rows.z, elapsed=rows.elapsed)
        taken, left = slice(forward.taken), rows.part(slice(forward.taken, None))
        if not forward.taken:
            return left
        innovation, deviation = estimates.innovation[taken], estimates.deviation[taken]
        self.log_likelihood += float(np.nansum(log_densities(innovation, deviation)))
        if self._judge is not None:
            self._judge(innovation, deviation)
        state, n = self._smoother.state, self._model.states
        determined = bool(state["phase"] == DETERMINED)
        variances = state["P"][: n * n : n + 1].copy()
        self._held.append(_Stretch(forward, estimates, rows.verdicts[taken], determined, variances))
        return left

    def _final_rows(self) -> list[EstimatedRows]:
        """Return the smoothed rows of the stretches that have enough later rows."""
        rows = np.array([stretch.forward_pass.taken for stretch in self._held])
        if len(rows) < _STRETCHES:
            return []
        self._reach = self._reach or self._usual_reach
        after = rows[::-1].cumsum()[::-1] - rows  # number of rows after each stretch
        if rows.sum() < self._reach + max(self._reach, _STRETCHES * self._length):  # so that tests are rare
            return []
        cuts = [k for k, stretch in enumerate(self._held) if stretch.determined and after[k] >= self._reach]
        if not cuts:
            return []
        future = self._future_of(self._held[cuts[-1] + 1 :])
        if future is None:
            self._reach *= 2
            return []
        self._reach = self._usual_reach
        return self._smoothed(cuts[-1] + 1, future)

    def _smoothed(self, count: int, future: NDArray[np.void]) -> list[EstimatedRows]:
        """Smooth and remove the first `count` stretches."""
        first, self._held = self._held[:count], self._held[count:]
        for stretch in reversed(first):
            self._smoother.backward(stretch.forward_pass, future)
        return [self._estimated(stretch) for stretch in first]

    def _estimated(self, stretch: _Stretch) -> EstimatedRows:
        taken = slice(stretch.forward_pass.taken)
        estimates = stretch.estimates.rows(taken)
        verdicts = np.where(estimates.verdict == Verdict.USED, stretch.verdicts, estimates.verdict)
        rows = estimates._replace(verdict=verdicts).to_rows()
        return rows._replace(parts=parts_of(self._component, estimates)) if self._split else rows

    def _future_of(self, later: Sequence[_Stretch]) -> NDArray[np.void] | None:
        """Return the information of the later rows on the state before them; None if more rows are needed."""
        variances = [stretch.variances for stretch in later if stretch.determined]
        if not variances:
            return None
        n, future, other = self._model.states, self._smoother.no_later_rows(), self._smoother.no_later_rows()
        other["M"][: n * n : n + 1] = _DIFFERENT / np.min(variances, axis=0)
        for one in (future, other):
            self._pass_back(later, one)
        M, other_M = (one["M"][: n * n].reshape(n, n) for one in (future, other))
        scale = np.sqrt(np.diag(M))
        return future if np.all(np.abs(other_M - M) <= _SAME * np.outer(scale, scale)) else None

    def _pass_back(self, later: Sequence[_Stretch], future: NDArray[np.void]) -> None:
        """Pass back over the first `_reach` rows of the later stretches."""
        reach, parts = self._reach, list[tuple[_Stretch, int]]()
        for stretch in later:
            count = min(stretch.forward_pass.taken, max(reach, 0))
            parts.append((stretch, count))
            reach -= count
        for stretch, count in reversed(parts):
            if count:
                self._smoother.add_information(stretch.forward_pass, future, count)

    @cached_property
    def _usual_reach(self) -> int:
        """Return the number of rows, in whole blocks, after which the steady-state filter has forgotten its start."""
        return BLOCK * (1 + int(min(rows_until_decayed(NEGLIGIBLE_SHARE, self._model), _FAR) // BLOCK))
