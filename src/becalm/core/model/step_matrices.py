"""A cache of the matrices F and Q of steps of any length."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, Integers
from becalm.core.model.components import Component
from becalm.core.model.model import Model, System

_MOST = 1024  # largest number of cached lengths


class StepMatrices:
    """The step matrices of a component, cached by step length.

    Parameters
    ----------
    component : Component
        A component whose unit of time is one step.

    Attributes
    ----------
    output : (1, n) float array
        Output matrix of the component.
    """

    def __init__(self, component: Component) -> None:
        self._component, self.output = component, component.output
        self._cache: dict[float, tuple[Floats, Floats]] = {}

    def over(self, lengths: Floats) -> tuple[Floats, Floats]:
        """Return F and Q, (u, n, n) each, over steps of several lengths (u,), as `Component.over` does."""
        requested = lengths.tolist()
        missing = [length for length in dict.fromkeys(requested) if length not in self._cache]
        if missing:
            if len(self._cache) + len(missing) > _MOST:
                self._cache.clear()
                missing = list(dict.fromkeys(requested))
            matrices = self._component.over(np.array(missing, dtype=np.float64))
            self._cache.update(zip(missing, zip(*matrices, strict=True), strict=True))
        cached = [self._cache[length] for length in requested]
        return np.stack([F for F, _ in cached]), np.stack([Q for _, Q in cached])


# The step before each row of a record, stored as runs of rows with equal steps.


class Timeline(NamedTuple):
    """The step matrices of a record: the step with index step[s] precedes each of rows first[s] to first[s + 1] - 1."""

    system: System
    first: Integers  # (runs + 1,) the last entry is the number of rows
    step: Integers  # (runs,) index of a step; -1: no step, as before the first row
    lengths: Floats  # (u,) lengths of the steps, in the model's time unit

    def step_before(self, row: int) -> int:
        """Return the index of the step before a row; -1 if there is none."""
        return int(self.step[np.searchsorted(self.first, row, side="right") - 1])


def model_system(model: Model) -> System:
    """Return the matrices of a model of even steps."""
    return System(model.F[np.newaxis], model.process_covariance[np.newaxis], model.H, model.R)


def even_timeline(model: Model, count: int, *, continues: bool = False) -> Timeline:
    """Return a timeline with the model's step before each row; the first row has one only if `continues`."""
    return Timeline(model_system(model), *_runs([0, 1, count], [0 if continues else -1, 0]), np.ones(1))


def elapsed_timeline(
    component: Component | StepMatrices, noise_variance: float, elapsed: Floats, *, continues: bool = False
) -> Timeline:
    """Return a timeline whose steps span the exact time since the row before.

    Parameters
    ----------
    component : Component or StepMatrices
        Model of the signal, with the time unit of `elapsed`, or the cache of the model's step matrices.
    noise_variance : float
        R, in unit^2.
    elapsed : (N,) float array
        Time since the row before, 0 or more.
    continues : bool
        True if earlier rows were already filtered; otherwise the first entry of `elapsed` is not used.
    """
    begin = 0 if continues else 1
    rest = elapsed[begin:]
    first = np.concatenate([[0], np.flatnonzero(rest[1:] != rest[:-1]) + 1]) if len(rest) else np.zeros(0, np.int64)
    lengths, step = np.unique(rest[first], return_inverse=True)
    F, Q = component.over(lengths if len(lengths) else np.ones(1))
    system = System(F, Q, component.output.copy(), np.array([[noise_variance]], dtype=np.float64))
    if continues:
        return Timeline(system, *_runs([*first, len(elapsed)], step), lengths)
    return Timeline(
        system, *_runs(np.concatenate([[0], first + 1, [len(elapsed)]]), np.concatenate([[-1], step])), lengths
    )


def _runs(first: object, step: object) -> tuple[Integers, Integers]:
    """Return bounds and steps without empty runs."""
    bounds, steps = np.asarray(first, dtype=np.int64), np.asarray(step, dtype=np.int64)
    bounds = np.minimum(bounds, bounds[-1])
    kept = np.flatnonzero(np.diff(bounds) > 0)
    return np.append(bounds[kept], bounds[-1]), steps[kept]
