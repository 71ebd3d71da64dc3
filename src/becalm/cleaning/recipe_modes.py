"""The part of a channel's recipe that tells the modes of a filter that switches."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from becalm.cleaning.recipe_parts import FrozenSettings, NotNegative, Positive


class ModeRecipe(FrozenSettings):
    """One way in which the signal of a channel may behave.

    Attributes
    ----------
    name : str
        As "still".
    order : int
        Which derivative is driven by white noise.
    process_noise_density : float
        q, in unit^2/s^(2 order - 1); a *small* one trusts the model and smooths more.
    level_noise_density : float
        Variance that the level gathers besides, in unit^2/s; a large one lets it jump, while slopes and tones go on.
    noise_std : float
        Standard deviation of one reading's noise in this mode, in unit.
    lasts_s : float
        How long it lasts on average, in seconds; a *large* one trusts it to stay.
    then : str
        The mode that comes after it; "" for any other.
    wild_share : float
        Share of wild readings; a *small* one believes in a switch sooner.
    damped_below_hz : float or None
        Motion slower than this is damped, as in the channel's recipe.
    with_tones : bool
        Whether the channel's tones and coloured noise are there in this mode.
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
    """The modes of a filter that switches.

    Attributes
    ----------
    kind : {"resting", "jumping", "noisy", "spiky", "bursting"}
        Which bank they are of.
    wild_std : float
        How far wild readings are spread beyond the noise, in unit; with a *small* one a far reading is a switch rather
        than wild.
    rejects : bool
        Whether they are left out.
    mode : tuple of ModeRecipe
        One of them is in force at a time.
    """

    kind: Literal["resting", "jumping", "noisy", "spiky", "bursting"]
    wild_std: NotNegative = 0.0
    rejects: bool = False
    mode: Annotated[tuple[ModeRecipe, ...], Field(min_length=1, max_length=8)]
