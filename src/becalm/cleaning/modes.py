"""The modes of a filter that switches: in seconds, as recipes tell them, and in steps, as filters use them."""

from __future__ import annotations

import numpy as np

from becalm.cleaning.recipe_modes import ModeRecipe, SwitchingRecipe
from becalm.core.components import Component, motion, with_walking_level
from becalm.core.switching import Mode, Switching
from becalm.errors import ModelError, RecipeError
from becalm.noise.likelihood import Tuning
from becalm.noise.switching import Switched

_LEAST, _GREATEST = 1e-250, 1e250  # of variances, unit^2: beyond, their products leave float64
_GREATEST_RATIO = 1e30  # of q/r: beyond, what is known of a state is lost to rounding


def modes_in_seconds(found: Switched, step_s: float) -> SwitchingRecipe:
    """Return the modes of a channel, found in steps, as its recipe tells them."""
    bank = found.switching
    return SwitchingRecipe(
        kind=found.kind,
        wild_std=float(np.sqrt(bank.wild_variance)),
        rejects=bank.rejects,
        mode=tuple(_mode_in_seconds(mode, step_s) for mode in bank.modes),
    )


def modes_in_steps(told: SwitchingRecipe, tuning: Tuning, step_s: float) -> Switching:
    """Return the modes of a recipe in steps.

    Parameters
    ----------
    told : SwitchingRecipe
        Its modes.
    tuning : Tuning
        The channel's fixed filter, whose tones go with the modes that are said to have them.
    step_s : float
        Step, in seconds.

    Raises
    ------
    RecipeError
        If they make no filter at this step.
    """
    try:
        with np.errstate(all="ignore"):
            modes = tuple(_mode_in_steps(mode, tuning, step_s) for mode in told.mode)
            return Switching(modes, float(np.float64(told.wild_std) ** 2), told.rejects)
    except ModelError as cause:
        raise RecipeError(f"The recipe's modes make no filter at {1 / step_s:.6g} Hz: {cause}") from cause


def _mode_in_seconds(mode: Mode, step_s: float) -> ModeRecipe:
    order = len(mode.component.parts[0].state_names)
    return ModeRecipe(
        name=mode.name,
        order=order,
        process_noise_density=float(mode.component.noise_density[0, 0]) / step_s ** (2 * order - 1),
        level_noise_density=_level_noise(mode.component) / step_s,
        noise_std=float(np.sqrt(mode.noise_variance)),
        lasts_s=mode.lasts * step_s,
        then=mode.then,
        wild_share=mode.wild_share,
        with_tones=len(mode.component.parts) > 1,
    )


def _level_noise(component: Component) -> float:
    """Return the density by which a level walks besides its motion; it is the last noise that enters."""
    walks = len(component.noise_density) > 1 and component.noise_input[0, -1] == 1.0
    return float(component.noise_density[-1, -1]) if walks else 0.0


def _mode_in_steps(told: ModeRecipe, tuning: Tuning, step_s: float) -> Mode:
    density = float(np.float64(told.process_noise_density) * np.float64(step_s) ** (2 * told.order - 1))
    variance = float(np.float64(told.noise_std) ** 2)
    if not (_LEAST < variance < _GREATEST and density / variance < _GREATEST_RATIO):
        raise ModelError(
            f"mode {told.name!r} has process_noise_density = {told.process_noise_density:.3g} and noise_std ="
            f" {told.noise_std:.3g}, which is out of reach; mend one of them, or choose a unit nearer to its size."
        )
    component = motion(told.order, density)
    if told.with_tones:
        component = sum(tuning.companions, component)
    if told.level_noise_density > 0:
        component = with_walking_level(component, told.level_noise_density * step_s)
    return Mode(told.name, component, variance, told.lasts_s / step_s, told.then, told.wild_share)
