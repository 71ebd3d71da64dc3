"""The tables of a channel's recipe for a filter with several modes (IMM)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from becalm.cleaning.recipe_parts import FrozenSettings, NotNegative, Positive


class ModeRecipe(FrozenSettings):
    """One mode: one way in which the signal of a channel may behave.

    Attributes
    ----------
    name : str
        Name of the mode, such as "still".
    order : int
        Order n of the motion: the n-th derivative of the signal is white noise.
    process_noise_density : float
        q, in unit^2/s^(2 order - 1); a *small* one trusts the model and smooths more.
    level_noise_density : float
        Additional random walk of the level, in unit^2/s; a *large* one lets the level jump, while slopes and tones
        continue.
    noise_std : float
        Standard deviation of one reading's noise in this mode, in unit.
    lasts_s : float
        Mean duration of the mode, in seconds; with a *large* one the filter leaves it late.
    then : str
        The mode that follows it; "" for any other.
    wild_share : float
        Share of outliers among the readings; with a *small* one the filter changes the mode sooner.
    damped_below_hz : float or None
        Motion slower than this is damped, as in the channel's recipe.
    with_tones : bool
        Whether this mode has the tones and the coloured noise of the channel.
    """

    name: Annotated[str, Field(min_length=1)]
    order: Annotated[int, Field(ge=1, le=5)]
    process_noise_density: NotNegative
    level_noise_density: NotNegative = 0.0
    noise_std: Positive
    lasts_s: Positive
    then: str = ""
    wild_share: Annotated[float, Field(ge=0, lt=1)] = 0.0
    damped_below_hz: Positive | None = None
    with_tones: bool = False


class SwitchingRecipe(FrozenSettings):
    """The modes of a filter with several modes (IMM).

    Attributes
    ----------
    kind : {"resting", "jumping", "noisy", "spiky", "bursting"}
        Kind of change that the modes describe.
    wild_std : float
        Additional standard deviation of outliers, in unit; with a *small* one a far reading is a change of mode rather
        than an outlier.
    rejects : bool
        Whether outliers are left out.
    mode : tuple of ModeRecipe
        One of them is in force at a time.
    """

    kind: Literal["resting", "jumping", "noisy", "spiky", "bursting"]
    wild_std: NotNegative = 0.0
    rejects: bool = False
    mode: Annotated[tuple[ModeRecipe, ...], Field(min_length=1, max_length=8)]
