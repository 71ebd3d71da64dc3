"""A channel of a stream on its own: with a fixed lag, with modes that switch, or passed on unchanged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import partial
from typing import Any, Protocol

import numpy as np

from becalm.cleaning.faults import SensorWatch
from becalm.cleaning.filtered import FilteredChannel
from becalm.cleaning.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.core.filter.fixed_lag_flow import FixedLagFlow
from becalm.core.filter.live_restarting import LiveFlow, LiveRestarting
from becalm.core.imm.fixed_lag_flow import FixedLagImmFlow
from becalm.core.imm.flow import ImmFlow
from becalm.core.imm.modes import InteractingModels
from becalm.core.rows import EstimatedRows
from becalm.core.verdict import Verdict, counted
from becalm.native.scans import HOP


class LiveChannel(Protocol):
    """What takes the rows of one channel, and gives clean ones back, perhaps later."""

    counts: Counter[Verdict]
    """How often each verdict was given."""

    sensor: SensorWatch

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and the steps before them; return what is clean, in order."""
        ...

    def finish(self) -> list[EstimatedRows]:
        """Return the rest; only a snapshot taken before brings the channel back."""
        ...

    def saved(self) -> dict[str, Any]:
        """Return what rows depend on, as arrays."""
        ...

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        ...


class LiveMotion(FilteredChannel):
    """A channel that is filtered; parameters as of `FilteredChannel`, and the later rows that each row waits for."""

    def __init__(self, recipe: ChannelRecipe, step_s: float, lag: int) -> None:
        super().__init__(recipe, step_s, lag)
        runs, look = self._runs, self.sensor.look
        self._flow: LiveFlow
        if runs.modes is None:
            part, variance = runs.tuning.component, runs.noise_variance
            assert runs.lag, "a causal filter without modes is a `CausalChannel`"
            self._flow = FixedLagFlow(part, variance, lag=runs.lag, judge=look, gate=runs.gate)
        else:
            self._flow = LiveRestarting(partial(self._opened, runs.modes), runs.gap_limit, runs.largest)

    def _opened(self, modes: InteractingModels) -> LiveFlow:
        lag, look = self._runs.lag, self.sensor.look
        if lag:
            return FixedLagImmFlow(modes, lag=lag, judge=look, tells_modes=True)
        return ImmFlow(modes, causal=True, judge=look, tells_modes=True)

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and the steps before them; return what is clean, in order."""
        if self._timing is not None:
            self._timing.push(elapsed)
        return self._counted(self._filtered(*self.sensor.push(z, elapsed)))

    def finish(self) -> list[EstimatedRows]:
        """Return the rest; only a snapshot taken before brings the channel back."""
        return self._counted([*self._filtered(*self.sensor.finish()), *self._flow.finish()])

    def _filtered(self, usable: Floats, elapsed: Floats) -> list[EstimatedRows]:
        if not len(usable):
            return []
        self._sentinel.push(usable)
        steps = np.round(elapsed) if self._runs.tuning.component.goes_in_steps else elapsed
        return self._flow.push(usable, steps)

    def _counted(self, told: list[EstimatedRows]) -> list[EstimatedRows]:
        return super()._counted([part for part in told if len(part.signal)])

    def saved(self) -> dict[str, Any]:
        """Return what rows depend on, as arrays."""
        timing = {} if self._timing is None else self._timing.saved()
        beside = self.sensor.saved() | self._sentinel.saved() | timing
        return self._flow.saved() | beside | {"counts": _listed(self.counts)}

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        self._flow.restore(arrays)
        self.sensor.restore(arrays)
        self._sentinel.restore(arrays)
        self.counts = _named(arrays["counts"])
        if self._timing is not None:
            self._timing.restore(arrays)


class LiveUnchanged:
    """A channel that is given back; parameters as of `FilteredChannel`."""

    def __init__(self, recipe: ChannelRecipe, step_s: float) -> None:
        self.sensor, self.counts = SensorWatch(recipe.limits, step_s, shown=False), Counter[Verdict]()

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and give them back."""
        (readings, _), count = self.sensor.push(z, elapsed), len(z)
        nothing = EstimatedRows(readings, np.full(count, np.nan), np.empty((0, count)), np.zeros(count, np.int8))
        told = self.sensor.named([nothing])
        self.counts.update(counted(told[0].verdicts))
        return told

    def finish(self) -> list[EstimatedRows]:
        """Return nothing: all was given back."""
        return []

    def saved(self) -> dict[str, Any]:
        """Return what rows depend on, as arrays."""
        return self.sensor.saved() | {"counts": _listed(self.counts)}

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        self.sensor.restore(arrays)
        self.counts = _named(arrays["counts"])


def open_live(recipe: ChannelRecipe, step_s: float, lag: int) -> LiveChannel:
    """Start a channel of its own as its recipe says."""
    return LiveUnchanged(recipe, step_s) if recipe.motion is None else LiveMotion(recipe, step_s, lag)


def mean_power(powers: Floats) -> float | None:
    """Return the mean square of innovations of which so many hops are summed, in sigma^2; None without any."""
    return float(powers.mean()) / HOP if len(powers) else None


def _listed(counts: Counter[Verdict]) -> Any:
    return np.array([counts[verdict] for verdict in Verdict])


def _named(counts: Any) -> Counter[Verdict]:
    return Counter(dict(zip(Verdict, counts.tolist(), strict=True)))
