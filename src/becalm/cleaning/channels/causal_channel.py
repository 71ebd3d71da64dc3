"""Filter a channel causally with a fixed model, in a file or in a stream, and check the times of its rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from becalm.cleaning.channels.judging import systematic_std
from becalm.cleaning.recipes.limits_entry import alarms_of, limits_of
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.steps import gate_of, in_steps
from becalm.core.arrays import Floats, input_of
from becalm.core.filter.channel import Channel, Estimates, History
from becalm.core.filter.channel_settings import ChannelSettings, Widening
from becalm.core.health.faults import TimeFaults, possible_steps


def is_causal(recipe: ChannelRecipe, lag: int | None) -> bool:
    """Return whether a channel has one causal filter, without modes; `lag` in rows, None for a smoother."""
    return recipe.motion is not None and recipe.switching is None and lag == 0


class CausalChannel:
    """A causal filter of one channel that also checks the times of its rows.

    Parameters
    ----------
    recipe : ChannelRecipe
        Recipe of the channel, in seconds and units.
    step_s : float
        One step, in seconds.

    Attributes
    ----------
    filter : Channel
        The filter.
    settings : ChannelSettings
        Settings of the filter.

    Raises
    ------
    RecipeError
        If the recipe's parameters do not make a valid filter at this step.
    """

    def __init__(self, recipe: ChannelRecipe, step_s: float) -> None:
        self.settings = _settings(recipe, step_s)
        self.filter = Channel(self.settings)
        self._time_faults, self._has_rows = TimeFaults(self.settings.limits), False

    def process(self, z: Floats, elapsed: Floats, *, states: bool = False) -> Estimates:
        """Process the next rows.

        Parameters
        ----------
        z : (B,) float array
            Measurements, in unit; NaN where missing.
        elapsed : (B,) float array
            Steps since the previous row; ignored for the very first row.
        states : bool
            Whether to return the filtered states as well.
        """
        z, elapsed = input_of(z), input_of(elapsed)
        even = bool((elapsed[0 if self._has_rows else 1 :] == 1.0).all())
        if not even or not self._has_rows:
            elapsed = possible_steps(elapsed).copy()
            elapsed[: 0 if self._has_rows else 1] = 1.0  # the first row is on time
        self._has_rows = self._has_rows or len(z) > 0
        if even and self._time_faults.undisturbed:
            return self.filter.process(z, elapsed, states=states)
        timing = np.zeros(len(z), np.int8)
        self._time_faults.write(timing, elapsed)
        return self.filter.process(z, elapsed, timing, states=states)

    def set_history(self, before: History) -> None:
        """Set the history before the first row."""
        self.filter.set_history(before)
        self._has_rows = before.rows > 0

    def comparable_state(self) -> dict[str, Any]:
        """Return the part of the state that later rows depend on, for comparison; see `Channel.comparable_state`."""
        offsets = self._time_faults.offsets
        return self.filter.comparable_state() | {"rhythm": offsets - offsets[-1]}

    def state_dict(self) -> dict[str, Any]:
        """Return the state as arrays."""
        offsets = self._time_faults.offsets if not self._time_faults.undisturbed else self._time_faults.offsets[:0]
        return self.filter.state_dict() | {"rhythm": offsets, "begun": np.array([int(self._has_rows)])}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the state that `state_dict` returned.

        Raises
        ------
        ModelError
            If the arrays are not a state of this channel.
        """
        self.filter.load_state_dict(arrays)
        self._time_faults.offsets[:] = arrays["rhythm"] if len(arrays["rhythm"]) else 0
        self._has_rows = bool(arrays["begun"][0])


def _settings(recipe: ChannelRecipe, step_s: float) -> ChannelSettings:
    assert recipe.motion is not None, "a channel without a motion passes unchanged"
    tuning, timing = in_steps(recipe.motion, step_s), recipe.timing
    return ChannelSettings(
        tuning.component,
        tuning.noise_variance,
        step_s,
        limits_of(recipe.limits),
        alarms_of(recipe.limits),
        None if recipe.gate is None else gate_of(recipe.gate, step_s),
        Widening(
            1.0 + recipe.tuning_spread,
            None if timing is None else timing.std_s,
            0.0 if timing is None else timing.included_std,
            systematic_std(recipe.calibration, recipe.limits),
        ),
        recipe.hole_sigma,
    )
