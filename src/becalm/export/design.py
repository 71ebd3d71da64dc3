"""A channel's filter as numbers that another language needs: gains found beforehand, nothing left to decide.

In steps and in the channel's unit, covariances in unit^2. A filter with a settled gain, in floating or fixed point,
carries the *predicted* state p, so that a settled row is y = C p + C K nu and p = F p + F K nu, with nu = z - H p.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from becalm.cleaning.filters import Filter
from becalm.cleaning.limits_entry import limits_of
from becalm.cleaning.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.core.filter.gate import Gate
from becalm.core.health.limits import Limits
from becalm.core.imm.modes import InteractingModels
from becalm.core.model.covariances import covariance_ahead
from becalm.core.model.magnitudes import largest_beside
from becalm.core.model.model import Model
from becalm.core.model.parts import Component
from becalm.core.steady.opening_gains import Opening, open_at
from becalm.core.steady.response import Response, describe
from becalm.core.steady.steady_filter import SteadyFilter
from becalm.core.steady.steady_gain import rows_until, steady
from becalm.errors import ModelError

NOT_IN_C = (
    "outlier_distance",
    "causal_outlier_distance",
    "blank",
    "far_from_0",
    "plausible_low",
    "plausible_high",
)
"""Limits of a recipe that settled and fixed filters have not: gross outliers, fills, and a last sentinel."""

_COUNTABLE = (1 << 32) - 1
_UNMOVED = 1e-8  # of a state: its square is what is left of a covariance, and less than float64 holds beside it
_MOST_COASTED = (1 << 16) - 2  # rows, which two bytes count


@dataclass(frozen=True, eq=False)
class Design:
    """The filter of one channel.

    Attributes
    ----------
    name, unit : str
        As in the recipe.
    step_s : float
        One step, in seconds.
    component : Component
        The signal and its disturbances; where the recipe switches, those of its richest mode.
    model : Model
        Of it and the noise of readings, one step a reading.
    limits : Limits
        What readings keep to.
    gate : Gate or None
        What leaves spikes out.
    modes : InteractingModels or None
        The bank, where the recipe switches.
    longest_gap : int
        Steps across which a filter with a covariance is carried; the largest number for any.
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
        """Number of states, n."""
        return self.model.states

    @property
    def output(self) -> Floats:
        """What of the state is signal, C (n,): H without disturbances."""
        return np.asarray(self.component.signal_output[0], dtype=np.float64)

    @property
    def level_direction(self) -> Floats:
        """What is added to the state (n,) with a constant to the signal; to the first state alone where it fades."""
        direction = self.component.level_direction
        return np.eye(self.states)[0] if direction is None else direction

    @property
    def unit_after(self) -> str:
        """The unit after a number: with a space before it, or nothing where it is not known."""
        return f" {self.unit}" if self.unit else ""

    @property
    def noise_variance(self) -> float:
        """R, in unit^2; of a bank the least of its modes."""
        return self.modes.least_noise_variance if self.modes else float(self.model.R[0, 0])

    @property
    def noise_std(self) -> float:
        """Standard deviation of a reading's noise, in unit."""
        return float(np.sqrt(self.noise_variance))

    @property
    def largest(self) -> float:
        """Magnitude beyond which a value is no reading, in unit."""
        return min(self.limits.largest, largest_beside(self.noise_variance))

    @cached_property
    def opening(self) -> Opening:
        """How the first readings tell the state."""
        return open_at(self.model)

    @cached_property
    def steady(self) -> SteadyFilter | None:
        """The filter once its gain has settled; None of one that never forgets its start."""
        try:
            found = steady(self.model, self.output)
        except ModelError:
            return None
        forgets = bool(abs(found.poles[0]) < 1 - 1e-13) and found.model.states == self.states
        return found if forgets else None

    @cached_property
    def response(self) -> Response | None:
        """The settled filter in an engineer's words; None of one that never settles, or of a bank."""
        if self.steady is None or self.modes is not None:
            return None
        return describe(self.model, self.step_s, causal=True, output=self.output)

    @property
    def settled_std(self) -> float:
        """Standard deviation of the settled signal's error where the model holds, in unit; inf where there is none."""
        return float(np.sqrt(self.steady.error_variance())) if self.steady else np.inf

    @property
    def motion_order(self) -> int:
        """How many of the first states are a motion, without the level that it returns to: the rest fades, or turns."""
        return len(self.component.parts[0].state_names) - self.component.returns

    @cached_property
    def settled_rows(self) -> int:
        """Complete rows after which a gain is what it will be to the last digit; the largest number for never."""
        rows = rows_until(_UNMOVED, self.model) if self.steady else np.inf
        return int(min(np.ceil(1.1 * rows) + 32, _COUNTABLE)) if np.isfinite(rows) else _COUNTABLE

    @property
    def settles(self) -> bool:
        """Whether its gain is what it will be after rows that can be counted."""
        return self.steady is not None and self.settled_rows < _COUNTABLE

    @property
    def is_reached(self) -> bool:
        """Whether some gap is so long that it begins anew."""
        return self.longest_gap < _COUNTABLE

    @cached_property
    def coasts(self) -> int:
        """Rows without a reading after which what is predicted is worth less than one reading; 1 at the least.

        A settled gain is that of an undisturbed row; beyond so many rows it is better to begin anew.
        """
        if self.steady is None:
            return _MOST_COASTED
        P, H, R = self.steady.predicted_cov, self.model.H, float(self.model.R[0, 0])
        worth, rows = max(R, 2 * float((H @ P @ H.T)[0, 0])), 0
        P_plus = P - self.steady.gain @ (H @ P)
        while rows < _MOST_COASTED:
            P_plus = covariance_ahead(P_plus, self.model)
            if float((H @ P_plus @ H.T)[0, 0]) > worth:
                break
            rows += 1
        return max(rows, 1)


def spread_of(steady: SteadyFilter) -> Floats:
    """Return the standard deviation (n,) of each predicted state of a settled filter, in its unit."""
    return np.asarray(np.sqrt(np.maximum(np.diag(steady.predicted_cov), 0.0)), dtype=np.float64)


def design_of(recipe: ChannelRecipe, step_s: float) -> Design | None:
    """Return the filter of a channel; None of one that passes unchanged.

    Parameters
    ----------
    recipe : ChannelRecipe
        In seconds and units.
    step_s : float
        One step, in seconds.

    Raises
    ------
    RecipeError
        If its numbers make no filter at this step.
    """
    if recipe.motion is None:
        return None
    runs = Filter(recipe, step_s, 0)
    component = runs.modes.component if runs.modes else runs.tuning.component
    return Design(
        recipe.name,
        recipe.unit,
        step_s,
        component,
        component.to_model(1.0, runs.noise_variance),
        limits_of(recipe.limits),
        runs.gate,
        runs.modes,
        int(min(runs.gap_limit.longest, _COUNTABLE)),
    )
