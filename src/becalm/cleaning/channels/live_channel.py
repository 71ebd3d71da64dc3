"""Clean one channel of a stream: with a fixed lag, with several modes, or without a filter.

A channel with one causal filter is a `CausalChannel` instead.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import partial
from typing import Any, Protocol

import numpy as np

from becalm.cleaning.channels.faults import SensorWatch
from becalm.cleaning.channels.filters import FilteredChannel
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.core.filter.fixed_lag_flow import FixedLagFlow
from becalm.core.filter.live_restarting import LiveFlow, LiveRestartingFlow
from becalm.core.imm.fixed_lag_flow import FixedLagImmFlow
from becalm.core.imm.flow import ImmFlow
from becalm.core.imm.modes import InteractingModels
from becalm.core.reading_verdicts import Verdict, counted
from becalm.core.rows import EstimatedRows
from becalm.native.scans import HOP


class LiveChannel(Protocol):
    """A cleaner of one channel of a stream: it takes rows in blocks and returns their estimates at once or later."""

    counts: Counter[Verdict]
    """How often each verdict was given."""

    sensor: SensorWatch
    """Check of the readings for faults."""

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and the steps since the previous row (B,); return the rows that are ready, in order."""
        ...

    def finish(self) -> list[EstimatedRows]:
        """Return the remaining rows. Afterwards only a state that was saved before this call can be continued."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """Return the state as arrays."""
        ...

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the state that `state_dict` returned."""
        ...


class LiveFilteredChannel(FilteredChannel):
    """A channel that is filtered; parameters as in `FilteredChannel`, `lag` in rows."""

    def __init__(self, recipe: ChannelRecipe, step_s: float, lag: int) -> None:
        super().__init__(recipe, step_s, lag)
        design, judge = self._filter, self.sensor.add_innovations
        self._flow: LiveFlow
        if design.modes is None:
            component, variance = design.tuning.component, design.noise_variance
            assert design.lag, "a causal filter without modes is a `CausalChannel`"
            self._flow = FixedLagFlow(component, variance, lag=design.lag, judge=judge, gate=design.gate)
        else:
            self._flow = LiveRestartingFlow(
                partial(self._open_modes, design.modes), design.gap_limit, design.largest_magnitude
            )

    def _open_modes(self, modes: InteractingModels) -> LiveFlow:
        lag, judge = self._filter.lag, self.sensor.add_innovations
        if lag:
            return FixedLagImmFlow(modes, lag=lag, judge=judge, with_probabilities=True)
        return ImmFlow(modes, causal=True, judge=judge, with_probabilities=True)

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and the steps since the previous row (B,); return the rows that are ready, in order."""
        if self._timing is not None:
            self._timing.push(elapsed)
        return self._counted(self._estimate(*self.sensor.push(z, elapsed)))

    def finish(self) -> list[EstimatedRows]:
        """Return the remaining rows. Afterwards only a state that was saved before this call can be continued."""
        return self._counted([*self._estimate(*self.sensor.finish()), *self._flow.finish()])

    def _estimate(self, usable: Floats, elapsed: Floats) -> list[EstimatedRows]:
        if not len(usable):
            return []
        self._sentinel.push(usable)
        steps = np.round(elapsed) if self._filter.tuning.component.has_recursion else elapsed
        return self._flow.push(usable, steps)

    def _counted(self, rows: list[EstimatedRows]) -> list[EstimatedRows]:
        return super()._counted([part for part in rows if len(part.signal)])

    def state_dict(self) -> dict[str, Any]:
        """Return the state as arrays."""
        timing = {} if self._timing is None else self._timing.state_dict()
        others = self.sensor.state_dict() | self._sentinel.state_dict() | timing
        return self._flow.state_dict() | others | {"counts": _to_array(self.counts)}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the state that `state_dict` returned."""
        self._flow.load_state_dict(arrays)
        self.sensor.load_state_dict(arrays)
        self._sentinel.load_state_dict(arrays)
        self.counts = _from_array(arrays["counts"])
        if self._timing is not None:
            self._timing.load_state_dict(arrays)


class LiveUnfilteredChannel:
    """A channel without a filter; parameters as in `FilteredChannel`."""

    def __init__(self, recipe: ChannelRecipe, step_s: float) -> None:
        self.sensor, self.counts = SensorWatch(recipe.limits, step_s, has_innovations=False), Counter[Verdict]()

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take readings (B,) and return them; a faulty reading becomes NaN and gets a verdict."""
        (readings, _), count = self.sensor.push(z, elapsed), len(z)
        unchanged = EstimatedRows(readings, np.full(count, np.nan), np.empty((0, count)), np.zeros(count, np.int8))
        rows = self.sensor.with_verdicts([unchanged])
        self.counts.update(counted(rows[0].verdicts))
        return rows

    def finish(self) -> list[EstimatedRows]:
        """Return no rows: `push` returned all of them."""
        return []

    def state_dict(self) -> dict[str, Any]:
        """Return the state as arrays."""
        return self.sensor.state_dict() | {"counts": _to_array(self.counts)}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the state that `state_dict` returned."""
        self.sensor.load_state_dict(arrays)
        self.counts = _from_array(arrays["counts"])


def open_live(recipe: ChannelRecipe, step_s: float, lag: int) -> LiveChannel:
    """Return the cleaner of a stream's channel for which `is_causal` returns False; `lag` in rows."""
    return LiveUnfilteredChannel(recipe, step_s) if recipe.motion is None else LiveFilteredChannel(recipe, step_s, lag)


def mean_nis_of_hops(sums: Floats) -> float | None:
    """Return the mean squared normalised innovation from its sums over 16 readings each, (H,); None without sums."""
    return float(sums.mean()) / HOP if len(sums) else None


def _to_array(counts: Counter[Verdict]) -> Any:
    return np.array([counts[verdict] for verdict in Verdict])


def _from_array(counts: Any) -> Counter[Verdict]:
    return Counter(dict(zip(Verdict, counts.tolist(), strict=True)))
