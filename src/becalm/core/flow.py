"""A channel of any length, a stretch of rows at a time, in constant memory; the numbers are those of the whole.

Causal, each stretch goes on from the memory of the one before. Smoothed, a stretch waits until so many
later rows are there that all later ones could change nothing any more: how far the last of them still
reaches back is measured, by coming back from there with two futures as different as can be.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.components import Component
from becalm.core.filtering import Pass, Run, Task, Wanted, go_on, start_filter
from becalm.core.gates import Gate, Gatekeeper, with_jumps
from becalm.core.kernel_ahead import BLOCK
from becalm.core.kernel_return import Future, new_future
from becalm.core.kernel_settling import COVARIANCE, GAIN, rename_last_step
from becalm.core.possible import largest_beside, level_by
from becalm.core.smoothing import forward_pass, go_back, room_to_return
from becalm.core.starting import first_reading
from becalm.core.steady import rows_until
from becalm.core.timeline import Timeline, elapsed_timeline
from becalm.core.told import Belief, Rows, Told
from becalm.core.verdict import Verdict
from becalm.core.verdict import judge as judge_readings

FORGOTTEN = 1e-13
"""Share by which what later rows say may still depend on rows that are not there yet."""

_DIFFERENT = 1e14  # two futures this far apart ...
_SAME = 1e-12  # ... have come this close: then FORGOTTEN, squared, lies between
_FAR = 1 << 40
_MOST_NUMBERS = 1 << 21  # of covariances that are held at once, where they are asked for

Judge = Callable[[Floats, Floats], None]
"""Takes innovations and their expected standard deviations, (B,) each."""


class _Stretch(NamedTuple):
    timeline: Timeline
    z: Floats  # (B, 1)
    run: Run
    verdicts: Codes  # (B,)


class Flow:
    """A filter, or a smoother, of one channel that is fed a stretch of rows at a time.

    Parameters
    ----------
    component : Component
        The signal's model, in steps.
    noise_variance : float
        R, in unit^2.
    causal : bool
        Whether to filter (True) or to smooth.
    judge : callable, optional
        Shown the innovations of each stretch.
    split : bool
        Whether to tell the share of each part of the component, disturbances among them, too.
    gate : Gate, optional
        What leaves spikes out, and follows steps; by default every reading is believed.
    """

    def __init__(  # noqa: PLR0913  (each by its name)
        self,
        component: Component,
        noise_variance: float,
        *,
        causal: bool,
        judge: Judge | None = None,
        split: bool = False,
        gate: Gate | None = None,
    ) -> None:
        self._component, self._variance, self._judge, self._split = component, noise_variance, judge, split
        self._model = component.to_model(1.0, noise_variance)
        self._disturbed = any(part.disturbance for part in component.parts)
        states = self._disturbed or split
        self._gate = None if gate is None else Gatekeeper(self._model, gate, takes_back=not causal)
        judged = judge is not None or gate is not None
        self._wanted = Wanted(states=states, covariances=self._disturbed, innovations=judged)
        enough = COVARIANCE if self._disturbed else GAIN
        self._how = Pass(self._wanted, enough) if causal else forward_pass(self._wanted)
        self._causal = causal
        self._level: float | None = None if component.keeps_level else 0.0  # what all readings are told from
        self._memory: Floats | None = None
        self._last_step = np.nan  # length of the step before the last row, if that was complete and no start
        self._waiting: list[Rows] = []  # until the readings tell the state, or whether it jumped
        self._few = Rows.nothing()  # rows that make no stretch yet
        self._held: deque[_Stretch] = deque()  # until what follows tells the future
        self.rows = 0
        self.log_likelihood = 0.0
        self.settled_row: int | None = None

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take the next rows, readings (B,) and the steps before them; return what can be told for good.

        All stretches but the last should be of a multiple of 256 rows, so that the bits are those of one.
        """
        readings = judge_readings(z, largest_beside(self._variance))
        rows = Rows(readings.readings, elapsed, readings.verdicts)
        if not self._causal:  # a smoother comes back over many rows for each stretch, so that few are no stretch
            rows = self._few = Rows.joined([self._few, rows])
            if len(rows.z) < BLOCK:
                return []
            self._few = Rows.nothing()
        most = _MOST_NUMBERS // len(self._model.F) ** 2 // BLOCK * BLOCK if self._wanted.states else _FAR
        told = [self._push(rows.part(slice(at, at + most))) for at in range(0, max(len(rows.z), 1), most)]
        return [part for parts in told for part in parts]

    def _push(self, rows: Rows, *, ends: bool = False) -> list[Told]:
        rows = Rows.joined([*self._waiting, rows._replace(z=self._told_from_level(rows.z))])
        self._waiting, told = [], []
        if self._causal and self._memory is None and (unread := first_reading(rows.z[:, np.newaxis]) // BLOCK * BLOCK):
            told, rows = [self._nothing(rows.verdicts[:unread])], rows.part(slice(unread, None))
        stretch = self._filter(rows, ends) if len(rows.z) else None
        return told if stretch is None else [*told, *self._tell(stretch)]

    def finish(self) -> list[Told]:
        """Say that no more rows will come; return what was waiting for them."""
        told = self._push(self._few, ends=True)
        if self._waiting:
            rows, self._waiting = Rows.joined(self._waiting), []
            timeline = elapsed_timeline(self._component, self._variance, rows.elapsed)
            run = start_filter(self._model, timeline, rows.z[:, np.newaxis], Pass(self._wanted))
            told.append(self._told(Belief.of(run.estimate), rows.verdicts))
            self._count(run, len(rows.z))
        future = new_future(self._model.states)
        back = [self._smooth(stretch, future) for stretch in reversed(self._held)]
        self._held.clear()
        return [*told, *reversed(back)]

    def saved(self) -> dict[str, Any] | None:
        """Return what later rows depend on, as arrays; None while rows wait, before a reading came, of a smoother."""
        if self._memory is None or self._waiting or not self._causal:
            return None
        gate = np.empty(0) if self._gate is None else self._gate.counters.copy()
        told = np.array([self._how.enough, self._level or 0.0, self._last_step])
        return {"flow_memory": self._memory[0], "flow_told": told, "flow_gate": gate}

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        self._memory = arrays["flow_memory"][np.newaxis]
        _, self._level, self._last_step = arrays["flow_told"].tolist()
        if self._gate is not None:
            self._gate.counters = arrays["flow_gate"]

    def tell_from(self, reading: float) -> None:
        """Tell all readings from one that came first, before those that will be pushed."""
        self._level = level_by(reading, self._variance) if self._level is None else self._level

    def _told_from_level(self, z: Floats) -> Floats:
        """Tell readings from the first one, so that a large offset does not cost the digits of what moves."""
        if self._level is None and (row := first_reading(z[:, np.newaxis])) < len(z):
            self._level = level_by(float(z[row]), self._variance)
        return z - self._level if self._level else z

    def _told(self, belief: Belief, verdicts: Codes) -> Told:
        signal, sigma, level = belief.signal[0], belief.sigma[0], self._level or 0.0
        if self._disturbed:
            C = self._component.signal_output[0]
            signal = C @ belief.mean
            sigma = np.sqrt(np.maximum(np.einsum("i,ijk,j->k", C, belief.cov, C), 0.0))
            sigma[np.isnan(signal)] = np.inf  # no state is known there, and of 0 inf nothing
        if level:
            signal += level  # in place: nobody else reads it
        parts = np.empty((0, len(signal)))
        if self._split:
            parts = np.array([output[0] @ belief.mean for _, output in self._component.outputs()])
            parts[0] += level
            parts = signal[np.newaxis] if len(parts) == 1 else parts
        return Told(signal, sigma, parts, verdicts)

    def _filter(self, rows: Rows, ends: bool) -> _Stretch | None:
        """Run forward over a stretch; None while the readings do not tell the state. Rows that must wait do so.

        Only where an innovation is too large does the gate look at the rows, and the filter run once more.
        """
        z, verdicts, goes_on = rows.z[:, np.newaxis], rows.verdicts, self._memory is not None
        timeline = elapsed_timeline(self._component, self._variance, rows.elapsed, goes_on=goes_on)
        run = self._run(timeline, z)
        if run.opening is not None and not run.opening.known:
            self._waiting = [rows]
            return None
        if self._gate is not None and self._gate.suspects(run.estimate):
            before = self._gate.counters
            gated = self._gate.judge(timeline, z, run.begun, self._belief(run))
            if gated.undecided >= 0 and not (self._causal or ends):
                self._gate.counters, cut = before, gated.undecided // BLOCK * BLOCK
                stretch = self._filter(rows.part(slice(cut)), ends) if cut else None
                self._waiting.append(rows.part(slice(cut, None)))
                return stretch
            if gated.rejects:
                timeline, z = with_jumps(timeline, gated.rows, gated.jumps), gated.readings(z)
                verdicts, run = gated.beside(verdicts), self._run(timeline, z)
        self._memory = run.memory[:1].copy()
        counts = run.begun < len(z) and bool(np.isfinite(z[-1, 0])) and verdicts[-1] != Verdict.STEP
        self._last_step = float(rows.elapsed[-1]) if counts else np.nan
        self._count(run, len(z))
        return _Stretch(timeline, z, run, verdicts)

    def _run(self, timeline: Timeline, z: Floats) -> Run:
        """Filter readings (B, 1) from what is remembered."""
        if self._memory is None:
            return start_filter(self._model, timeline, z, self._how)
        memory, same = self._memory.copy(), np.flatnonzero(timeline.lengths == self._last_step)
        rename_last_step(memory[0], self._model.states, 1, int(same[0]) if len(same) else None)
        return go_on(self._model, timeline, z, memory, self._how)

    def _belief(self, run: Run) -> Floats:
        """Return mean and covariance before the first row that a run has filtered."""
        if self._memory is not None:
            return np.ravel(self._memory)
        assert run.opening is not None, "a flow starts flat"
        return np.concatenate([run.opening.x, run.opening.P.ravel()])

    def _count(self, run: Run, rows: int) -> None:
        found = run.estimate
        self.log_likelihood += found.log_likelihood
        if self.settled_row is None and found.settled_row is not None:
            self.settled_row = self.rows + found.settled_row
        self.rows += rows
        if self._judge is not None:
            self._judge(found.innovations[:, 0], found.innovation_sigma[:, 0])

    def _nothing(self, verdicts: Codes) -> Told:
        """Tell of rows before the first reading, which need not wait for it."""
        rows = len(verdicts)
        unknown = np.full(rows, np.nan)
        self.rows += rows
        if self._judge is not None:
            self._judge(unknown, unknown)
        parts = np.full((len(self._component.parts) if self._split else 0, rows), np.nan)
        return Told(unknown, np.full(rows, np.inf), parts, verdicts)

    def _tell(self, stretch: _Stretch) -> list[Told]:
        if self._causal:
            return [self._told(Belief.of(stretch.run.estimate), stretch.verdicts)]
        self._held.append(stretch)
        told: list[Told] = []
        while len(self._held) > 1:
            future = self._future_of(list(self._held)[1:])
            if future is None:
                break
            told.append(self._smooth(self._held.popleft(), future))
        return told

    def _smooth(self, stretch: _Stretch, future: Future) -> Told:
        trace = room_to_return(self._model, stretch.run, self._wanted._replace(innovations=False))
        task = Task(self._model, stretch.timeline, stretch.z, stretch.run.begun)
        go_back(task, stretch.run, self._how, future, trace)
        return self._told(Belief(trace.signal, trace.sigma, trace.mean, trace.cov), stretch.verdicts)

    def _future_of(self, later: Sequence[_Stretch]) -> Future | None:
        """Return what all rows after a stretch say of its end; None if more of them are needed to know."""
        available, reach = sum(len(stretch.z) for stretch in later), self._reach
        while True:
            future = self._come_back(later, reach, new_future(self._model.states))
            other = new_future(self._model.states)
            other.N[:] = _DIFFERENT * self._most_that_can_be_said(later)
            other = self._come_back(later, reach, other)
            scale = np.sqrt(np.diag(future.N))
            if np.all(np.abs(other.N - future.N) <= _SAME * np.outer(scale, scale)):
                return future
            if reach >= available:
                return None
            reach *= 2

    def _most_that_can_be_said(self, later: Sequence[_Stretch]) -> Floats:
        """Return the diagonal matrix of 1 / P at its smallest: P - P N P >= 0 bounds every N."""
        n = self._model.states
        variances = slice(n, n + n * n, n + 1)
        filled = [stretch.run.memory[: 2 + (len(stretch.z) - 1) // BLOCK, variances] for stretch in later]
        smallest = np.concatenate(filled).min(axis=0)
        return np.diag(1 / smallest)

    def _come_back(self, later: Sequence[_Stretch], reach: int, future: Future) -> Future:
        """Carry a future back from `reach` rows ahead, or from the last there is."""
        parts = []
        for stretch in later:
            count = min(len(stretch.z), reach)
            parts.append((stretch, count))
            reach -= count
        for stretch, count in reversed(parts):
            if count:
                task = Task(self._model, stretch.timeline, stretch.z[:count], stretch.run.begun)
                trace = room_to_return(self._model, stretch.run, Wanted(signal=False, sigma=True))
                go_back(task, stretch.run, self._how, future, trace)
        return future

    @cached_property
    def _reach(self) -> int:
        """Rows after which a steady filter has forgotten where it came from, in whole blocks."""
        return BLOCK * (1 + int(min(rows_until(FORGOTTEN, self._model), _FAR) // BLOCK))
