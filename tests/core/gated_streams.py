"""What tests of gates share: a gate, motions, and a stream in chunks."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.filter.filtering import WantedResults, run_filter
from becalm.core.filter.gate import WIDE, Gate
from becalm.core.model.components import Component, motion
from becalm.core.model.model import Model, System
from becalm.core.model.step_matrices import StepMatrices, Timeline
from becalm.core.online import Online
from becalm.core.reading_verdicts import Verdict

GATE = Gate(5.0)
PARTS = {order: motion(order, (2 * np.pi * 0.01) ** (2 * order)) for order in (1, 2, 3)}


def model_of(order: int) -> Model:
    return PARTS[order].to_model(1.0, 1.0)


def with_jumps(component: Component, elapsed: Floats, z: Floats, verdicts: Codes) -> Timeline:
    """Return the timeline of a record (N,) of decided readings, in which each row that jumps follows a step of its own.

    What makes the innovation likely, rounded up to a power of 4, is added to the variance of the level; soon after
    another jump to those of all states, in proportion, but no more than what moves the next reading as far.
    """
    model, n = component.to_model(1.0, 1.0), len(component.drift)
    F, Q = (matrices.copy() for matrices in StepMatrices(component).over(elapsed))
    step, since = np.append(-1, np.arange(1, len(z))), 0
    for row in range(n, len(z)):
        if verdicts[row] == Verdict.STEP:
            line = Timeline(System(F, Q, model.H, model.R), np.arange(row + 1), step[:row], elapsed)
            told = run_filter(model, line, z[:row, np.newaxis], WantedResults(states=True, covariances=True)).estimate
            assert told.mean is not None and told.cov is not None  # noqa: PT018
            x, P = F[row] @ told.mean[-1], F[row] @ told.cov[-1] @ F[row].T + Q[row]
            square, hPh = (z[row] - (model.H @ x)[0]) ** 2, (model.H @ P @ model.H.T)[0, 0]
            level = since >= GATE.at_most
            added = rounded_up(square * (np.arange(n) == 0) if level else min(square, WIDE) * np.diag(P) / hPh)
            if not level:
                room = rounded_up(min(square, WIDE) / (model.H @ F[row])[0] ** 2) - np.diag(P)
                added = np.minimum(added, np.maximum(room, 0.0))
            Q[row] += np.diag(added)
            since = 0 if level else 1 - n
        elif verdicts[row] == Verdict.USED:
            since += 1
    return Timeline(System(F, Q, model.H, model.R), np.arange(len(z) + 1), step, elapsed)


def rounded_up(variance: Floats) -> Floats:
    """Return the next powers of 4."""
    return np.where(variance > 0, 4.0 ** np.ceil(np.log2(np.maximum(variance, 1e-300)) / 2), 0.0)


def in_chunks(online: Online, z: Floats, cuts: list[int]) -> tuple[Floats, Floats, Codes]:
    """Return signal, sigma and verdicts of a stream that is cut."""
    out = []
    for start, stop in zip([0, *cuts], [*cuts, len(z)], strict=True):
        signal, sigma = online.run(z[start:stop])
        assert online.verdicts is not None
        out.append((signal, sigma, online.verdicts))
    signal, sigma, verdicts = (np.concatenate(parts) for parts in zip(*out, strict=True))
    return signal, sigma, verdicts
