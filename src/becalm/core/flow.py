"""A channel of any length, a stretch of rows at a time, in constant memory; the numbers are those of the whole.

Causal, each stretch goes on from the memory of the one before. Smoothed, a stretch waits until so many
later rows are there that all later ones could change nothing any more: how far the last of them still
reaches back is measured, by coming back from there with two futures as different as can be.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.components import Component
from becalm.core.filtering import Estimate, Pass, Run, Task, Wanted, go_on, start_filter
from becalm.core.kernel_ahead import BLOCK
from becalm.core.kernel_return import Future, new_future
from becalm.core.kernel_settling import COVARIANCE, GAIN, rename_last_step
from becalm.core.smoothing import forward_pass, go_back, room_to_return
from becalm.core.starting import first_reading
from becalm.core.steady import steady
from becalm.core.timeline import Timeline, elapsed_timeline
from becalm.errors import ModelError

FORGOTTEN = 1e-13
"""Share by which what later rows say may still depend on rows that are not there yet."""

_DIFFERENT = 1e14  # two futures this far apart ...
_SAME = 1e-12  # ... have come this close: then FORGOTTEN, squared, lies between
_FAR = 1 << 40
_MOST_NUMBERS = 1 << 21  # of covariances that are held at once, where they are asked for

Judge = Callable[[Floats, Floats], None]
"""Takes innovations and their expected standard deviations, (B,) each."""


class Told(NamedTuple):
    """The result of some rows."""

    signal: Floats  # (B,)
    sigma: Floats  # (B,)
    parts: Floats  # (p, B) the share of each part, where they were asked for; otherwise (0, B)

    def rows(self, which: slice) -> Told:
        """Return some of the rows."""
        return Told(self.signal[which], self.sigma[which], self.parts[:, which])

    @classmethod
    def nothing(cls) -> Told:
        """Return no rows."""
        return cls(np.empty(0), np.empty(0), np.empty((0, 0)))


class _Belief(NamedTuple):
    """What is believed of some rows."""

    signal: Floats  # (1, B)
    sigma: Floats  # (1, B)
    mean: Floats  # (n, B) where wanted
    cov: Floats  # (n, n, B) where wanted

    @classmethod
    def of(cls, estimate: Estimate) -> _Belief:
        mean = np.empty((0, 0)) if estimate.mean is None else estimate.mean.T
        cov = np.empty((0, 0, 0)) if estimate.cov is None else np.moveaxis(estimate.cov, 0, 2)
        return cls(estimate.signal.T, estimate.sigma.T, mean, cov)


class _Stretch(NamedTuple):
    timeline: Timeline
    z: Floats  # (B, 1)
    run: Run


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
    """

    def __init__(
        self,
        component: Component,
        noise_variance: float,
        *,
        causal: bool,
        judge: Judge | None = None,
        split: bool = False,
    ) -> None:
        self._component, self._variance, self._judge, self._split = component, noise_variance, judge, split
        self._model = component.to_model(1.0, noise_variance)
        self._disturbed = any(part.disturbance for part in component.parts)
        states = self._disturbed or split
        self._wanted = Wanted(states=states, covariances=self._disturbed, innovations=judge is not None)
        enough = COVARIANCE if self._disturbed else GAIN
        self._how = Pass(self._wanted, enough) if causal else forward_pass(self._wanted)
        self._causal = causal
        self._level: float | None = None if component.keeps_level else 0.0  # what all readings are told from
        self._memory: Floats | None = None
        self._last_step = 0.0
        self._waiting: list[tuple[Floats, Floats]] = []  # until the readings tell the state
        self._few = (np.empty(0), np.empty(0))  # rows that make no stretch yet
        self._held: deque[_Stretch] = deque()  # until what follows tells the future
        self.rows = 0
        self.log_likelihood = 0.0
        self.settled_row: int | None = None

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take the next rows, readings (B,) and the steps before them; return what can be told for good.

        All stretches but the last should be of a multiple of 256 rows, so that the bits are those of one.
        """
        if not self._causal:  # a smoother comes back over many rows for each stretch, so that few are no stretch
            z, elapsed = (np.concatenate(parts) for parts in zip(self._few, (z, elapsed), strict=True))
            self._few = (z, elapsed)
            if len(z) < BLOCK:
                return []
            self._few = (z[:0], elapsed[:0])
        most = _MOST_NUMBERS // len(self._model.F) ** 2 // BLOCK * BLOCK if self._wanted.states else _FAR
        told = [self._push(z[at : at + most], elapsed[at : at + most]) for at in range(0, max(len(z), 1), most)]
        return [part for parts in told for part in parts]

    def _push(self, z: Floats, elapsed: Floats) -> list[Told]:
        z = self._told_from_level(z)
        if self._waiting:
            z, elapsed = (np.concatenate(parts) for parts in zip(*self._waiting, (z, elapsed), strict=True))
        self._waiting, told = [], []
        if self._causal and self._memory is None and (unread := first_reading(z[:, np.newaxis]) // BLOCK * BLOCK):
            told, z, elapsed = [self._nothing(unread)], z[unread:], elapsed[unread:]
        if not len(z):
            return told
        goes_on = self._memory is not None
        timeline = elapsed_timeline(self._component, self._variance, elapsed, goes_on=goes_on)
        stretch = self._filter(timeline, z[:, np.newaxis], elapsed)
        if stretch is None:
            self._waiting = [(z, elapsed)]
            return told
        return [*told, *self._tell(stretch)]

    def finish(self) -> list[Told]:
        """Say that no more rows will come; return what was waiting for them."""
        told = self._push(*self._few)
        if self._waiting:
            (z, elapsed), self._waiting = self._waiting[0], []
            timeline = elapsed_timeline(self._component, self._variance, elapsed)
            run = start_filter(self._model, timeline, z[:, np.newaxis], Pass(self._wanted))
            told.append(self._told(_Belief.of(run.estimate)))
            self._count(run, len(z))
        future = new_future(self._model.states)
        back = [self._smooth(stretch, future) for stretch in reversed(self._held)]
        self._held.clear()
        return [*told, *reversed(back)]

    def _told_from_level(self, z: Floats) -> Floats:
        """Tell readings from the first one, so that a large offset does not cost the digits of what moves."""
        if self._level is None and (row := first_reading(z[:, np.newaxis])) < len(z):
            self._level = float(z[row])
        return z - self._level if self._level else z

    def _told(self, belief: _Belief) -> Told:
        signal, sigma, level = belief.signal[0], belief.sigma[0], self._level or 0.0
        if self._disturbed:
            C = self._component.signal_output[0]
            signal = C @ belief.mean
            sigma = np.sqrt(np.maximum(np.einsum("i,ijk,j->k", C, belief.cov, C), 0.0))
        parts = np.empty((0, len(signal)))
        if self._split:
            parts = np.array([output[0] @ belief.mean for _, output in self._component.outputs()])
            parts[0] += level
            if len(parts) == 1:
                parts = (signal + level)[np.newaxis]
        return Told(signal + level if level else signal, sigma, parts)

    def _filter(self, timeline: Timeline, z: Floats, elapsed: Floats) -> _Stretch | None:
        """Run forward over a stretch; None while the readings do not tell the state."""
        if self._memory is None:
            run = start_filter(self._model, timeline, z, self._how)
            if run.opening is not None and not run.opening.known:
                return None
        else:
            same = np.flatnonzero(timeline.lengths == self._last_step)
            rename_last_step(self._memory[0], self._model.states, 1, int(same[0]) if len(same) else None)
            run = go_on(self._model, timeline, z, self._memory, self._how)
        self._memory, self._last_step = run.memory[:1].copy(), float(elapsed[-1])
        self._count(run, len(z))
        return _Stretch(timeline, z, run)

    def _count(self, run: Run, rows: int) -> None:
        found = run.estimate
        self.log_likelihood += found.log_likelihood
        if self.settled_row is None and found.settled_row is not None:
            self.settled_row = self.rows + found.settled_row
        self.rows += rows
        if self._judge is not None:
            self._judge(found.innovations[:, 0], found.innovation_sigma[:, 0])

    def _nothing(self, rows: int) -> Told:
        """Tell of rows before the first reading, which need not wait for it."""
        unknown = np.full(rows, np.nan)
        self.rows += rows
        if self._judge is not None:
            self._judge(unknown, unknown)
        parts = np.full((len(self._component.parts) if self._split else 0, rows), np.nan)
        return Told(unknown, np.full(rows, np.inf), parts)

    def _tell(self, stretch: _Stretch) -> list[Told]:
        if self._causal:
            return [self._told(_Belief.of(stretch.run.estimate))]
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
        go_back(
            Task(self._model, stretch.timeline, stretch.z, stretch.run.begun), stretch.run, self._how, future, trace
        )
        return self._told(_Belief(trace.signal, trace.sigma, trace.mean, trace.cov))

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
        try:
            radius = float(np.abs(np.linalg.eigvals(steady(self._model).closed_loop)).max())
        except ModelError:  # it never forgets
            return _FAR
        if not radius < 1.0:
            return _FAR
        rows = np.log(1 / FORGOTTEN) / -np.log(max(radius, 1e-300))
        return BLOCK * (1 + int(min(rows, _FAR) // BLOCK))
