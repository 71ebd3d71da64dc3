"""A channel of a stream on its own: with a fixed lag, with modes that switch, or passed on unchanged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from becalm.cleaning.faults import SensorWatch
from becalm.cleaning.filters import reach_of_modes
from becalm.cleaning.modes import modes_in_steps
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.slopes import TimingNoise
from becalm.cleaning.steps import gate_of, in_steps
from becalm.cleaning.uncertainty import Uncertainty
from becalm.core.arrays import Floats
from becalm.core.kernel_watch import HOP
from becalm.core.lagged_flow import LaggedFlow
from becalm.core.live_parted import LiveFlow, LiveParted
from becalm.core.possible import largest_beside
from becalm.core.reach import reach_of
from becalm.core.switching_flow import SwitchingFlow
from becalm.core.switching_lag import LaggedSwitchingFlow
from becalm.core.told import Told
from becalm.core.verdict import Verdict, counted


class LiveChannel(Protocol):
    """What takes the rows of one channel, and gives clean ones back, perhaps later."""

    counts: Counter[Verdict]
    """How often each verdict was given."""

    sensor: SensorWatch

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take readings (B,) and the steps before them; return what is clean, in order."""
        ...

    def finish(self) -> list[Told]:
        """Return the rest; only a snapshot taken before brings the channel back."""
        ...

    def saved(self) -> dict[str, Any]:
        """Return what rows depend on, as arrays."""
        ...

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        ...


class LiveMotion:
    """A channel that is filtered.

    Parameters
    ----------
    recipe : ChannelRecipe
        In seconds and units.
    step_s : float
        Step in seconds.
    lag : int
        Later rows that each row waits for; 0 filters.

    Raises
    ------
    RecipeError
        If its numbers make no filter at this step.
    """

    def __init__(self, recipe: ChannelRecipe, step_s: float, lag: int) -> None:
        assert recipe.motion is not None, "what has no motion passes unchanged"
        self._recipe, self._step_s, self._lag = recipe, step_s, lag
        self._tuning = in_steps(recipe.motion, step_s)
        self._modes = None if recipe.switching is None else modes_in_steps(recipe.switching, self._tuning, step_s)
        self.sensor, self.counts = SensorWatch(recipe.limits, step_s), Counter[Verdict]()
        self._uncertainty = Uncertainty(recipe.tuning_spread, recipe.calibration)
        modes = self._modes
        noise_std = recipe.motion.noise_std if modes is None else float(np.sqrt(modes.modes[0].noise_variance))
        self._timing = None if recipe.timing is None else TimingNoise(recipe.timing, noise_std, step_s)
        if modes is not None:
            reach, least = reach_of_modes(modes), modes.least_noise_variance
        else:
            least = self._tuning.noise_variance
            reach = reach_of(self._tuning.component, least)
        self._flow = LiveParted(self._opened, reach, largest_beside(least))

    def _opened(self) -> LiveFlow:
        if self._modes is not None and self._lag:
            return LaggedSwitchingFlow(self._modes, lag=self._lag, judge=self.sensor.look)
        if self._modes is not None:
            return SwitchingFlow(self._modes, causal=True, judge=self.sensor.look)
        gate = None if self._recipe.gate is None else gate_of(self._recipe.gate, self._step_s)
        part, variance = self._tuning.component, self._tuning.noise_variance
        return LaggedFlow(part, variance, lag=self._lag, judge=self.sensor.look, gate=gate)

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take readings (B,) and the steps before them; return what is clean, in order."""
        if self._timing is not None:
            self._timing.push(elapsed)
        usable = self.sensor.push(z, elapsed)
        steps = np.round(elapsed) if self._tuning.component.goes_in_steps else elapsed  # no stream ends by a late row
        return self._counted(self._flow.push(usable, steps))

    def finish(self) -> list[Told]:
        """Return the rest; only a snapshot taken before brings the channel back."""
        return self._counted(self._flow.finish())

    def _counted(self, told: list[Told]) -> list[Told]:
        told = self.sensor.named([part for part in told if len(part.signal)])
        for part in told:
            self.counts.update(counted(part.verdicts))
        if self._timing is not None:
            told = [self._timing.widened(part) for part in told]
        return self._uncertainty.widened(told)

    def saved(self) -> dict[str, Any]:
        """Return what rows depend on, as arrays."""
        timing = {} if self._timing is None else self._timing.saved()
        return self._flow.saved() | self.sensor.saved() | timing | {"counts": _listed(self.counts)}

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        self._flow.restore(arrays)
        self.sensor.restore(arrays)
        self.counts = _named(arrays["counts"])
        if self._timing is not None:
            self._timing.restore(arrays)


class LiveUnchanged:
    """A channel that is given back; parameters as of `LiveMotion`."""

    def __init__(self, recipe: ChannelRecipe, step_s: float) -> None:
        self.sensor, self.counts = SensorWatch(recipe.limits, step_s, shown=False), Counter[Verdict]()

    def push(self, z: Floats, elapsed: Floats) -> list[Told]:
        """Take readings (B,) and give them back."""
        readings, count = self.sensor.push(z, elapsed), len(z)
        nothing = Told(readings, np.full(count, np.nan), np.empty((0, count)), np.zeros(count, np.int8))
        told = self.sensor.named([nothing])
        self.counts.update(counted(told[0].verdicts))
        return told

    def finish(self) -> list[Told]:
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
