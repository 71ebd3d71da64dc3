"""One channel on its way forward through a bank that switches, a stretch of rows at a time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import Codes, Floats, Integers
from becalm.core.kernel_switching import SwitchingTrace, switch_forward
from becalm.core.kernel_switching_row import Bank, memory_length
from becalm.core.possible import largest_beside, level_by
from becalm.core.starting import first_reading
from becalm.core.switching import Switching
from becalm.core.told import Judge, Told
from becalm.core.verdict import Judged, Verdict, judge
from becalm.errors import ModelError


class SwitchingFilter:
    """The forward pass, which goes on from the beliefs after the stretch before.

    Parameters
    ----------
    switching : Switching
        The modes, in steps.
    judge : callable, optional
        Shown the innovations of each stretch, of the mixture of all modes.
    split : bool
        Whether to tell the share of each part of the component, and then the probability of each mode.
    tells_modes : bool
        Whether to tell the probabilities alone, where nothing is split.
    """

    def __init__(
        self, switching: Switching, judge: Judge | None, *, split: bool = False, tells_modes: bool = False
    ) -> None:
        self.switching, self._judge, self._split, self._tells_modes = switching, judge, split, tells_modes
        self._beliefs = np.zeros(memory_length(switching.states, len(switching.modes)))
        self._level: float | None = None if switching.component.keeps_level else 0.0
        self._shares = np.zeros(len(switching.modes))
        self.rows = 0
        self.log_likelihood = 0.0

    @property
    def shares(self) -> dict[str, float]:
        """What share of the rows so far each mode was in force, as the filter believed at the time."""
        total = max(float(self._shares.sum()), 1.0)
        return {mode.name: float(share) / total for mode, share in zip(self.switching.modes, self._shares, strict=True)}

    def saved(self) -> dict[str, Floats]:
        """Return what rows depend on, as arrays."""
        level = np.nan if self._level is None else self._level
        return {"flow_beliefs": self._beliefs, "flow_told": np.array([level, float(self.rows)])}

    def restore(self, arrays: Mapping[str, Floats]) -> None:
        """Take over what `saved` returned; raises a ModelError if it is not that of such a bank."""
        level, rows = arrays["flow_told"].tolist()
        if arrays["flow_beliefs"].shape != self._beliefs.shape:
            raise ModelError("The snapshot's beliefs are not those of its bank; pass what snapshot() returned.")
        self._beliefs, self._level, self.rows = arrays["flow_beliefs"], None if np.isnan(level) else level, int(rows)

    def judged(self, z: Floats) -> Judged:
        """Let only possible readings (B,) through."""
        return judge(z, largest_beside(self.switching.least_noise_variance))

    def tell_from(self, reading: float) -> None:
        """Tell all readings from one that came first, before those that will be pushed."""
        self._level = level_by(reading, self.switching.least_noise_variance) if self._level is None else self._level

    def levelled(self, z: Floats) -> Floats:
        """Return readings (B,) less the first one of all, where the bank keeps a level."""
        if self._level is None and (row := first_reading(z[:, np.newaxis])) < len(z):
            self._level = level_by(float(z[row]), self.switching.least_noise_variance)
        return np.ascontiguousarray(z - (self._level or 0.0))

    def run(self, z: Floats, bank: Bank, steps: Integers, memory: Floats) -> SwitchingTrace:
        """Filter levelled readings (B,); `memory` is filled as `switch_forward` says."""
        memory[0, : len(self._beliefs)] = self._beliefs
        trace = self.room(len(z), innovations=self._judge is not None)
        total, _ = switch_forward(self.switching.sizes, bank, z, steps, self.switching.start, memory, trace)
        self._beliefs = memory[0, : len(self._beliefs)].copy()
        self.log_likelihood += total
        self.rows += len(z)
        self._shares += trace.probability.sum(axis=1)
        if self._judge is not None:
            self._judge(trace.innovation, trace.innovation_sigma)
        return trace

    def room(self, rows: int, *, innovations: bool = False) -> SwitchingTrace:
        """Make room for what is told of some rows; where nothing is known yet, sigma is inf."""
        modes, means = len(self.switching.modes), (self.switching.states if self._split else 0, rows)
        wanted = rows if innovations else 0
        return SwitchingTrace(
            signal=np.full(rows, np.nan),
            sigma=np.full(rows, np.inf),
            innovation=np.full(wanted, np.nan),
            innovation_sigma=np.full(wanted, np.nan),
            probability=np.zeros((modes, rows)),
            wild=np.zeros(rows if self.switching.rejects else 0),
            mean=np.full(means, np.nan),
        )

    def told(self, trace: SwitchingTrace, verdicts: Codes) -> Told:
        """Return what was found of some rows, with the level, and what became of their readings."""
        level, parts = self._level or 0.0, np.empty((0, len(trace.signal)))
        if self._split:
            shares = np.array([output[0] @ trace.mean for _, output in self.switching.component.outputs()])
            shares[0] += level
            parts = np.vstack([shares, trace.probability])
        elif self._tells_modes:
            parts = trace.probability
        return Told(trace.signal + level if level else trace.signal, trace.sigma, parts, verdicts)


class ByModes:
    """What every flow through a bank tells of it.

    Parameters
    ----------
    passes : SwitchingFilter
        The forward pass.
    """

    settled_row: int | None = None
    """None: a bank has no one gain that settles."""

    def __init__(self, passes: SwitchingFilter) -> None:
        self._filter = passes

    @property
    def switching(self) -> Switching:
        """The modes, in steps."""
        return self._filter.switching

    @property
    def shares(self) -> dict[str, float]:
        """What share of the rows so far each mode was in force, as the filter believed at the time."""
        return self._filter.shares

    @property
    def log_likelihood(self) -> float:
        """Of all readings so far but the first."""
        return self._filter.log_likelihood

    def saved(self) -> dict[str, Any]:
        """Return what rows depend on, as arrays, of one that tells rows at once or with a lag."""
        return dict(self._filter.saved())

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned; raises a ModelError if it is not that of such a bank."""
        self._filter.restore(arrays)

    def tell_from(self, reading: float) -> None:
        """Tell all readings from one that came first, before those that will be pushed."""
        self._filter.tell_from(reading)


def with_spikes(verdicts: Codes, trace: SwitchingTrace) -> Codes:
    """Return verdicts of some rows, with the readings that were more probably wild than not, and left out."""
    if not len(trace.wild):
        return verdicts
    spikes = (trace.wild > 0.5) & (verdicts == Verdict.USED)
    return np.where(spikes, Verdict.SPIKE, verdicts).astype(verdicts.dtype)
