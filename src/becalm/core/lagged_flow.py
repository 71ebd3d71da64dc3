"""A channel of any length, smoothed with a fixed lag, a stretch of rows at a time, in constant memory.

Rows go one by one, as in a stream, so that a channel in stretches is the whole one to the bit, wherever it is cut.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.components import Component
from becalm.core.fixed_lag import FixedLag
from becalm.core.gatekeeper import Gatekeeper
from becalm.core.gates import Gate
from becalm.core.kernel_settling import COVARIANCE, GAIN
from becalm.core.possible import largest_beside, level_by
from becalm.core.starting import first_reading
from becalm.core.steps import Steps
from becalm.core.timeline import elapsed_timeline
from becalm.core.told import Judge, Told
from becalm.core.verdict import judge as judge_readings


class LaggedFlow:
    """A fixed-lag smoother of one channel that is fed a stretch of rows at a time.

    Parameters
    ----------
    component : Component
        The signal's model, in steps.
    noise_variance : float
        R, in unit^2; a *small* one trusts the readings.
    lag : int
        Later rows that are waited for, 1 or more, however far apart; with a *small* one more noise is left.
    judge : callable, optional
        Shown the innovations of each stretch.
    split : bool
        Whether to tell the share of each part of the component, disturbances among them, too.
    gate : Gate, optional
        What leaves spikes out, and follows steps, as readings come; by default every reading is believed.

    Raises
    ------
    ModelError
        If the lag is no whole number.
    """

    def __init__(  # noqa: PLR0913  (each by its name)
        self,
        component: Component,
        noise_variance: float,
        *,
        lag: int,
        judge: Judge | None = None,
        split: bool = False,
        gate: Gate | None = None,
    ) -> None:
        self._variance, self._judge = noise_variance, judge
        disturbed = any(part.disturbance for part in component.parts)
        shares = [output for _, output in component.outputs()] if split else []
        output = np.vstack([component.signal_output if disturbed else component.output, *shares])
        self._split = split
        model = component.to_model(1.0, noise_variance)
        self._keeper = None if gate is None else Gatekeeper(model, gate)
        self._steps = Steps(component)
        self._late = FixedLag(model, lag, output, COVARIANCE if disturbed else GAIN, self._keeper)
        self._level: float | None = None if component.keeps_level else 0.0  # what all readings are told from
        self._verdicts: Codes = np.empty(0, np.int8)  # of rows that wait
        self.rows = 0
        self.log_likelihood = 0.0
        self.settled_row: int | None = None

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take the next rows, readings (B,) and the steps before them; return the rows that have waited for them."""
        if not len(z):
            return []
        judged = judge_readings(z, largest_beside(self._variance))
        z = judged.readings
        if self._level is None and (row := first_reading(z[:, np.newaxis])) < len(z):
            self._level = level_by(float(z[row]), self._variance)
        readings = (z - self._level if self._level else z)[:, np.newaxis]
        timeline = elapsed_timeline(self._steps, self._variance, elapsed, goes_on=self.rows > 0)
        late = self._late.push(timeline, readings, innovations=self._judge is not None)
        verdicts = judged.verdicts if late.gated is None else late.gated.beside(judged.verdicts)
        self._verdicts = np.concatenate([self._verdicts, verdicts])
        if self._judge is not None:
            self._judge(late.innovations[0], late.innovation_sigma[0])
        self.log_likelihood += late.sums.log_likelihood
        if self.settled_row is None and late.settled_row is not None:
            self.settled_row = self.rows + late.settled_row
        unwaited = max(0, self._late.lag - self.rows)  # rows that came with none so long before them
        self.rows += len(z)
        return [self._told(late.signal[:, unwaited:], late.sigma[:, unwaited:])]

    def finish(self) -> list[Told]:
        """Say that no more rows will come; return the last ones, with what there is after them."""
        return [self._told(*self._late.rest())]

    def saved(self) -> dict[str, Any]:
        """Return what rows depend on, as arrays."""
        level = np.nan if self._level is None else self._level
        moves = {"flow_told": np.array([level, float(self.rows)]), "flow_verdicts": self._verdicts}
        counters = {} if self._keeper is None else {"flow_gate": self._keeper.counters}
        return self._late.snapshot() | moves | counters

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned; raises a ModelError if it is not that of such a filter and lag."""
        self._late.restore(arrays)
        level, rows = arrays["flow_told"].tolist()
        self._level, self.rows = None if np.isnan(level) else level, int(rows)
        self._verdicts = arrays["flow_verdicts"]
        if self._keeper is not None:
            self._keeper.counters = arrays["flow_gate"]

    def tell_from(self, reading: float) -> None:
        """Tell all readings from one that came first, before those that will be pushed."""
        self._level = level_by(reading, self._variance) if self._level is None else self._level

    def _told(self, output: Floats, sigma: Floats) -> Told:
        output[: 1 + self._split] += self._level or 0.0  # the signal, and the motion, which is the first part
        rows = output.shape[1]
        verdicts, self._verdicts = self._verdicts[:rows], self._verdicts[rows:]
        return Told(np.ascontiguousarray(output[0]), np.ascontiguousarray(sigma[0]), output[1:], verdicts)
