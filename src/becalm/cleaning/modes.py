"""The modes of a filter that switches: in seconds, as recipes tell them, and in steps, as filters use them."""

from __future__ import annotations

import numpy as np

from becalm.cleaning.recipe_modes import ModeRecipe, SwitchingRecipe
from becalm.core.imm.modes import InteractingModels, Mode
from becalm.core.model.components import LEVEL_RATE, Component, motion, returning_motion, with_walking_level
from becalm.errors import ModelError, RecipeError
from becalm.identification.likelihood import Tuning
from becalm.identification.modes.banks import Kind

_LEAST, _GREATEST = 1e-250, 1e250  # of variances, unit^2: beyond, their products leave float64
_GREATEST_RATIO = 1e30  # of q/r: beyond, what is known of a state is lost to rounding


def modes_in_seconds(kind: Kind, bank: InteractingModels, step_s: float) -> SwitchingRecipe:
    """Return the modes of a channel, in steps of so many seconds, as its recipe tells them."""
    return SwitchingRecipe(
        kind=kind,
        wild_std=float(np.sqrt(bank.wild_variance)),
        rejects=bank.rejects,
        mode=tuple(_mode_in_seconds(mode, step_s) for mode in bank.modes),
    )


def modes_in_steps(told: SwitchingRecipe, tuning: Tuning, step_s: float) -> InteractingModels:
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
            return InteractingModels(modes, float(np.float64(told.wild_std) ** 2), told.rejects)
    except ModelError as cause:
        raise RecipeError(f"The recipe's modes make no filter at {1 / step_s:.6g} Hz: {cause}") from cause


def _mode_in_seconds(mode: Mode, step_s: float) -> ModeRecipe:
    states, component = len(mode.component.parts[0].state_names), mode.component
    order, damping = states, 0.0
    if component.returns:
        order, damping = states - 1, -float(component.drift[states - 1, states - 1]) / LEVEL_RATE
    return ModeRecipe(
        name=mode.name,
        order=order,
        process_noise_density=float(mode.component.noise_density[0, 0]) / step_s ** (2 * order - 1),
        level_noise_density=_level_noise(mode.component) / step_s,
        noise_std=float(np.sqrt(mode.noise_variance)),
        lasts_s=mode.lasts * step_s,
        then=mode.then,
        wild_share=mode.wild_share,
        damped_below_hz=damping / (2 * np.pi * step_s) if damping else None,
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
    damping = 0.0 if told.damped_below_hz is None else 2 * np.pi * told.damped_below_hz * step_s
    component = returning_motion(told.order, density, damping) if damping else motion(told.order, density)
    if told.with_tones:
        component = sum(tuning.companions, component)
    if told.level_noise_density > 0:
        component = with_walking_level(component, told.level_noise_density * step_s)
    return Mode(told.name, component, variance, told.lasts_s / step_s, told.then, told.wild_share)
