"""The forward pass of one channel through interacting multiple models, block by block."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.imm.modes import InteractingModels
from becalm.core.model.parts import largest_magnitude_for_noise, level_from_first_reading
from becalm.core.reading_verdicts import Judged, Verdict, judge
from becalm.core.rows import EstimatedRows, Judge
from becalm.errors import ModelError
from becalm.native.imm import ImmBuffers, ModeMatrices, Steps, filter_rows, new_state, restored


class ForwardImm:
    """The forward pass, which continues from the state after the previous block.

    Parameters
    ----------
    switching : InteractingModels
        The modes, in steps.
    judge : callable, optional
        It receives the innovations of each block, for the mixture of all modes, and their standard deviations.
    split : bool
        Whether to return also the contribution of each part of the component, then the probability of each mode.
    with_probabilities : bool
        Whether to return the probabilities without the contributions; used only if `split` is False.

    Attributes
    ----------
    state : () structured array
        The state of the modes after the rows so far.
    """

    def __init__(
        self,
        switching: InteractingModels,
        judge: Judge | None,
        *,
        split: bool = False,
        with_probabilities: bool = False,
    ) -> None:
        self.switching, self._judge, self._split, self._with_probabilities = switching, judge, split, with_probabilities
        self.state = new_state(switching.matrices(np.ones(1)), keeps_level=switching.component.keeps_level)
        self._shares = np.zeros(len(switching.modes))
        self.log_likelihood = 0.0

    @property
    def shares(self) -> dict[str, float]:
        """Return the share of the rows so far in each mode: the mean of the mode's filtered probability."""
        total = max(float(self._shares.sum()), 1.0)
        return {mode.name: float(share) / total for mode, share in zip(self.switching.modes, self._shares, strict=True)}

    def state_dict(self) -> dict[str, Any]:
        """Return the state that later rows depend on, as arrays."""
        return {"flow_modes": np.frombuffer(self.state.tobytes(), np.int8)}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`; raise a ModelError if it does not fit these modes."""
        state = restored(self.switching.matrices(np.ones(1)), arrays["flow_modes"])
        if state is None:
            raise ModelError("The snapshot's state does not fit its modes; pass what snapshot() returned.")
        self.state = state

    def judged(self, z: Floats) -> Judged:
        """Return readings (B,) with NaN in place of impossible values, and their verdicts."""
        return judge(z, largest_magnitude_for_noise(self.switching.least_noise_variance))

    def set_level(self, reading: float) -> None:
        """Set the level, which is subtracted from readings, to the record's first reading; call it before any push."""
        if not self.state["has_level"]:
            self.state["has_level"] = 1
            self.state["level"] = level_from_first_reading(reading, self.switching.least_noise_variance)

    def run(
        self,
        z: Floats,
        matrices: ModeMatrices,
        steps: Steps,
        *,
        before: Floats | None = None,
        notes: Floats | None = None,
    ) -> ImmBuffers:
        """Filter readings (B,); write `before` and `notes`, if they are given, as `filter_rows` does."""
        buffers = self.new_buffers(len(z), innovations=self._judge is not None)
        self.log_likelihood += filter_rows(matrices, self.state, z, steps, buffers, before=before, notes=notes)
        self._shares += buffers.probability.sum(axis=1)
        if self._judge is not None:
            self._judge(buffers.innovation, buffers.innovation_sigma)
        return buffers

    def new_buffers(self, rows: int, *, innovations: bool = False) -> ImmBuffers:
        """Allocate arrays for the results of `rows` rows; sigma is inf until it is written."""
        modes, means = len(self.switching.modes), (self.switching.states if self._split else 0, rows)
        wanted = rows if innovations else 0
        return ImmBuffers(
            signal=np.full(rows, np.nan),
            sigma=np.full(rows, np.inf),
            innovation=np.full(wanted, np.nan),
            innovation_sigma=np.full(wanted, np.nan),
            probability=np.zeros((modes, rows)),
            wild=np.zeros(rows if self.switching.rejects else 0),
            mean=np.full(means, np.nan),
        )

    def estimates_from(self, buffers: ImmBuffers, verdicts: Codes) -> EstimatedRows:
        """Return the contents of the buffers as `EstimatedRows`, with these verdicts."""
        parts = np.empty((0, len(buffers.signal)))
        if self._split:
            shares = np.array([output[0] @ buffers.mean for _, output in self.switching.component.outputs()])
            shares[0] += self.state["level"]
            parts = np.vstack([shares, buffers.probability])
        elif self._with_probabilities:
            parts = buffers.probability
        return EstimatedRows(buffers.signal, buffers.sigma, parts, verdicts)


class ImmFlowBase:
    """The base class of the IMM flows: properties and state of their forward pass.

    Parameters
    ----------
    forward : ForwardImm
        The forward pass.
    """

    settled_row: int | None = None
    """Always None: an IMM has no steady-state gain."""

    def __init__(self, forward: ForwardImm) -> None:
        self._filter = forward

    @property
    def switching(self) -> InteractingModels:
        """Return the modes, in steps."""
        return self._filter.switching

    @property
    def shares(self) -> dict[str, float]:
        """Return the share of the rows so far in each mode: the mean of the mode's filtered probability."""
        return self._filter.shares

    @property
    def log_likelihood(self) -> float:
        """Return the log-likelihood of all measurements so far; the first does not count."""
        return self._filter.log_likelihood

    def state_dict(self) -> dict[str, Any]:
        """Return the state that later rows depend on, as arrays; only for a filter or a fixed-lag smoother."""
        return dict(self._filter.state_dict())

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`; raise a ModelError if it does not fit these modes."""
        self._filter.load_state_dict(arrays)

    def set_level(self, reading: float) -> None:
        """Set the level, which is subtracted from readings, to the record's first reading; call it before any push."""
        self._filter.set_level(reading)


def with_spikes(verdicts: Codes, buffers: ImmBuffers) -> Codes:
    """Return the verdicts with SPIKE for each rejected reading: its probability of being wild is above one half."""
    if not len(buffers.wild):
        return verdicts
    spikes = (buffers.wild > 0.5) & (verdicts == Verdict.USED)
    return np.where(spikes, Verdict.SPIKE, verdicts).astype(verdicts.dtype)
