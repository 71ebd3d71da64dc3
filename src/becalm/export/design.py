"""Describe a channel's filter in plain numbers for another language; all gains are computed before any row.

Time is in steps, readings are in the channel's unit, and covariances in unit^2. A filter with a settled gain, in
floating or fixed point, stores the *predicted* state p. A row in the steady state is then y = C p + C K nu and
p = F p + F K nu, with the innovation nu = z - H p.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from becalm.cleaning.channels.filters import Filter
from becalm.cleaning.recipes.limits_entry import limits_of
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.core.filter.gate import Gate
from becalm.core.health.limits import Limits
from becalm.core.imm.modes import InteractingModels
from becalm.core.model.covariances import covariance_ahead
from becalm.core.model.model import Model
from becalm.core.model.parts import Component, largest_magnitude_for_noise
from becalm.core.steady.opening_gains import Opening, determine_state
from becalm.core.steady.response import Response, describe
from becalm.core.steady.steady_filter import SteadyFilter, rows_until_decayed, steady
from becalm.errors import ModelError

NOT_IN_C = (
    "outlier_distance",
    "causal_outlier_distance",
    "blank",
    "far_from_0",
    "plausible_low",
    "plausible_high",
)
"""Limits of a recipe that settled and fixed filters do not use: for gross outliers, fill values and runaways."""

_COUNTABLE = (1 << 32) - 1  # largest number of rows in four bytes; it also means "without limit"
_UNMOVED = 1e-8  # negligible share of the initial state; the same share of its variance is below float64's resolution
_MOST_COASTED = (1 << 16) - 2  # largest `Design.coasts`, which two bytes can count


@dataclass(frozen=True, eq=False)
class Design:
    """The filter of one channel as numbers.

    Attributes
    ----------
    name, unit : str
        Name and unit of the channel, from the recipe.
    step_s : float
        Duration of a step, in seconds.
    component : Component
        The models of the signal and of its disturbances; for an IMM, those of the mode with the most parts.
    model : Model
        State-space model of the component and the noise of readings, with one step per reading.
    limits : Limits
        Saturation limits and other limits of the readings, in unit.
    gate : Gate or None
        The innovation gate; None without a gate.
    modes : InteractingModels or None
        The IMM; None for a single filter.
    longest_gap : int
        Longest gap, in steps, that a filter with a covariance predicts across; 2^32 - 1 for no limit.
    """

    name: str
    unit: str
    step_s: float
    component: Component
    model: Model
    limits: Limits
    gate: Gate | None
    modes: InteractingModels | None
    longest_gap: int

    @property
    def states(self) -> int:
        """Return the number of states, n."""
        return self.model.states

    @property
    def output(self) -> Floats:
        """Return C (n,), which maps the state to the signal; it is H without the disturbances."""
        return np.asarray(self.component.signal_output[0], dtype=np.float64)

    @property
    def level_direction(self) -> Floats:
        """Return the permanent change of the state (n,) that adds 1 to the signal; (1, 0, ...) if there is none."""
        direction = self.component.level_direction
        return np.eye(self.states)[0] if direction is None else direction

    @property
    def unit_after(self) -> str:
        """Return the unit as it follows a number in a text: with a leading space, or "" if the unit is unknown."""
        return f" {self.unit}" if self.unit else ""

    @property
    def noise_variance(self) -> float:
        """Return R, in unit^2; for an IMM, the least R of its modes."""
        return self.modes.least_noise_variance if self.modes else float(self.model.R[0, 0])

    @property
    def noise_std(self) -> float:
        """Return the standard deviation of a reading's noise, in unit."""
        return float(np.sqrt(self.noise_variance))

    @property
    def largest(self) -> float:
        """Return the magnitude beyond which a reading is overrange, in unit."""
        return min(self.limits.largest, largest_magnitude_for_noise(self.noise_variance))

    @cached_property
    def opening(self) -> Opening:
        """Return the state, and its covariance, as a function of the first readings, which determine the state."""
        return determine_state(self.model)

    @cached_property
    def steady(self) -> SteadyFilter | None:
        """Return the steady-state filter; None if the start has a permanent effect, or a state is not observable."""
        try:
            filter_ = steady(self.model, self.output)
        except ModelError:
            return None
        fades = bool(abs(filter_.poles[0]) < 1 - 1e-13) and filter_.model.states == self.states
        return filter_ if fades else None

    @cached_property
    def response(self) -> Response | None:
        """Return the response of the steady-state filter; None without a steady state, and for an IMM."""
        if self.steady is None or self.modes is not None:
            return None
        return describe(self.model, self.step_s, causal=True, output=self.output)

    @property
    def settled_std(self) -> float:
        """Return sigma in the steady state, if the model is correct, in unit; inf without a steady state."""
        return float(np.sqrt(self.steady.error_variance())) if self.steady else np.inf

    @property
    def motion_order(self) -> int:
        """Return the number of states of the motion; the level to which a damped motion returns does not count."""
        return len(self.component.parts[0].state_names) - self.component.returns

    @cached_property
    def settled_rows(self) -> int:
        """Return the number of rows without missing readings after which the gain is constant; 2^32 - 1 if it never is.

        Constant means to the last digit of float64.
        """
        rows = rows_until_decayed(_UNMOVED, self.model) if self.steady else np.inf
        return int(min(np.ceil(1.1 * rows) + 32, _COUNTABLE)) if np.isfinite(rows) else _COUNTABLE

    @property
    def settles(self) -> bool:
        """Return whether the gain becomes constant after a number of rows that four bytes can count."""
        return self.steady is not None and self.settled_rows < _COUNTABLE

    @property
    def restarts_after_gap(self) -> bool:
        """Return whether there is a length of gap after which the filter starts anew."""
        return self.longest_gap < _COUNTABLE

    @cached_property
    def coasts(self) -> int:
        """Return the largest number of rows without a reading, 1 to 65534, after which a settled filter continues.

        After more such rows, a prediction is less accurate than one reading, and the settled gain, which is correct
        only without missing readings, is too small. It is then better to start anew.
        """
        if self.steady is None:
            return _MOST_COASTED
        P, H, R = self.steady.predicted_cov, self.model.H, float(self.model.R[0, 0])
        most_variance, rows = max(R, 2 * float((H @ P @ H.T)[0, 0])), 0
        P_plus = P - self.steady.gain @ (H @ P)
        while rows < _MOST_COASTED:
            P_plus = covariance_ahead(P_plus, self.model)
            if float((H @ P_plus @ H.T)[0, 0]) > most_variance:
                break
            rows += 1
        return max(rows, 1)


def spread_of(steady: SteadyFilter) -> Floats:
    """Return the prior standard deviation (n,) of each state in the steady state, in the state's unit."""
    return np.asarray(np.sqrt(np.maximum(np.diag(steady.predicted_cov), 0.0)), dtype=np.float64)


def design_of(recipe: ChannelRecipe, step_s: float) -> Design | None:
    """Return the filter of a channel as numbers; None for a channel that passes unchanged.

    Parameters
    ----------
    recipe : ChannelRecipe
        Recipe of the channel, in seconds and units.
    step_s : float
        Duration of a step, in seconds.

    Raises
    ------
    RecipeError
        If the numbers of the recipe do not make a valid filter at this step.
    """
    if recipe.motion is None:
        return None
    filter_ = Filter(recipe, step_s, 0)
    component = filter_.modes.component if filter_.modes else filter_.tuning.component
    return Design(
        recipe.name,
        recipe.unit,
        step_s,
        component,
        component.to_model(1.0, filter_.noise_variance),
        limits_of(recipe.limits),
        filter_.gate,
        filter_.modes,
        int(min(filter_.gap_limit.longest, _COUNTABLE)),
    )
