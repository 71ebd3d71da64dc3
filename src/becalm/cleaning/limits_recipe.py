"""What a recipe says of a channel's sensor: its rails, its codes, how long it may hold one, how its noise may be."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from becalm.core.clock import GAP_STEPS

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class LimitsRecipe(BaseModel):
    """What a channel keeps to while its sensor is healthy.

    Attributes
    ----------
    low, high : float or None
        The rails, in unit: readings there or beyond are clipped, and count as missing.
    resolution : float or None
        The step between two codes, in unit; None where readings lie on no lattice.
    stuck_readings : int or None
        From so many equal readings in a row on they count as missing; a *small* one finds a stuck channel
        sooner, and calls slow signals stuck.
    even_time : bool or None
        Whether rows came in even time, so that one can be late.
    gap_steps : float or None
        More steps than this since the row before are a gap; 1.5 by default.
    drift_threshold : float or None
        Of the cumulative sum of innovations, in sigma: a *small* one finds a drift sooner, and more that are
        none; None tells no drift.
    dead_variance : float or None
        Variance of a window of innovations, of the expected one, below which the channel is dead; a *small*
        one lets it rest, None tells no death.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    low: Finite | None = None
    high: Finite | None = None
    resolution: Positive | None = None
    stuck_readings: Annotated[int, Field(ge=2)] | None = None
    even_time: bool | None = None
    gap_steps: Annotated[float, Field(ge=GAP_STEPS, allow_inf_nan=False)] | None = None
    drift_threshold: Positive | None = None
    dead_variance: Positive | None = None

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low is not None and self.high is not None and self.low >= self.high:
            raise ValueError("low is not below high; a range goes from low to high")
        return self
