"""Which step precedes each row of a record: runs of rows that follow equal steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, Integers
from becalm.core.model.components import Component
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import StepMatrices
from becalm.core.model.system import System


class Timeline(NamedTuple):
    """The step matrices of a record, and where each is used: rows first[s] to first[s + 1] - 1 follow step[s]."""

    system: System
    first: Integers  # (runs + 1,) the last is the number of rows
    step: Integers  # (runs,) -1: no step, as before the first row
    lengths: Floats  # (u,) of the steps, in steps of the model

    def step_before(self, row: int) -> int:
        """Return which step precedes a row; -1 for none."""
        return int(self.step[np.searchsorted(self.first, row, side="right") - 1])


def model_system(model: Model) -> System:
    """Return the matrices of a model of even steps."""
    return System(model.F[np.newaxis], model.process_covariance[np.newaxis], model.H, model.R)


def even_timeline(model: Model, count: int, *, goes_on: bool = False) -> Timeline:
    """Give every row of `count` the model's own step, but the first only where the record goes on."""
    return Timeline(model_system(model), *_runs([0, 1, count], [0 if goes_on else -1, 0]), np.ones(1))


def elapsed_timeline(
    component: Component | StepMatrices, noise_variance: float, elapsed: Floats, *, goes_on: bool = False
) -> Timeline:
    """Give every row the exact step over the time since the row before.

    Parameters
    ----------
    component : Component or StepMatrices
        The signal's model, in the time unit of `elapsed`, or what remembers its steps.
    noise_variance : float
        R, in unit^2.
    elapsed : (N,) float array
        Time since the row before, 0 or more.
    goes_on : bool
        Whether a row before the first was filtered already; otherwise the first time is not used.
    """
    begin = 0 if goes_on else 1
    rest = elapsed[begin:]
    first = np.concatenate([[0], np.flatnonzero(rest[1:] != rest[:-1]) + 1]) if len(rest) else np.zeros(0, np.int64)
    lengths, step = np.unique(rest[first], return_inverse=True)
    F, Q = component.over(lengths if len(lengths) else np.ones(1))
    system = System(F, Q, component.output.copy(), np.array([[noise_variance]], dtype=np.float64))
    if goes_on:
        return Timeline(system, *_runs([*first, len(elapsed)], step), lengths)
    return Timeline(
        system, *_runs(np.concatenate([[0], first + 1, [len(elapsed)]]), np.concatenate([[-1], step])), lengths
    )


def _runs(first: object, step: object) -> tuple[Integers, Integers]:
    """Leave out runs of no rows."""
    bounds, steps = np.asarray(first, dtype=np.int64), np.asarray(step, dtype=np.int64)
    bounds = np.minimum(bounds, bounds[-1])
    kept = np.flatnonzero(np.diff(bounds) > 0)
    return np.append(bounds[kept], bounds[-1]), steps[kept]
