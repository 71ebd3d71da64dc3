"""Describe the filter of a channel, or each of its modes, by bandwidth, lag and noise gain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.cleaning.channels.report import ChannelReport, ModeReport
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import ModeRecipe, SwitchingRecipe
from becalm.cleaning.recipes.steps import in_steps
from becalm.core.imm.modes import InteractingModels, Mode
from becalm.core.model.components import LEVEL_RATE, Component, motion, returning_motion, with_walking_level
from becalm.core.steady.response import Response, describe
from becalm.errors import ModelError, RecipeError
from becalm.identification.likelihood import Tuning
from becalm.identification.modes.banks import Kind
from becalm.identification.trust.tuning_spread import independence_steps

# Convert the modes of an IMM between seconds (recipes) and steps (filters).

_LEAST, _GREATEST = 1e-250, 1e250  # range of variances, in unit^2: outside it, products of variances exceed float64
_GREATEST_RATIO = 1e30  # largest q/r: with a larger one, rounding errors destroy the state


def modes_in_seconds(kind: Kind, imm: InteractingModels, step_s: float) -> SwitchingRecipe:
    """Return the modes of an IMM as a recipe, converted from steps of `step_s` seconds to seconds."""
    return SwitchingRecipe(
        kind=kind,
        wild_std=float(np.sqrt(imm.wild_variance)),
        rejects=imm.rejects,
        mode=tuple(_mode_in_seconds(mode, step_s) for mode in imm.modes),
    )


def modes_in_steps(entry: SwitchingRecipe, tuning: Tuning, step_s: float) -> InteractingModels:
    """Return the modes of a recipe in steps.

    Parameters
    ----------
    entry : SwitchingRecipe
        Modes in seconds.
    tuning : Tuning
        Fixed filter of the channel, in steps; modes with `with_tones` get its tones and coloured noise.
    step_s : float
        One step, in seconds.

    Raises
    ------
    RecipeError
        If the modes do not make a valid filter at this step.
    """
    try:
        with np.errstate(all="ignore"):
            modes = tuple(_mode_in_steps(mode, tuning, step_s) for mode in entry.mode)
            return InteractingModels(modes, float(np.float64(entry.wild_std) ** 2), entry.rejects)
    except ModelError as cause:
        raise RecipeError(f"The recipe's modes do not make a valid filter at {1 / step_s:.6g} Hz: {cause}") from cause


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
    """Return the density, in unit^2/step, of the level's own random walk (the last noise input); 0 without one."""
    walks = len(component.noise_density) > 1 and component.noise_input[0, -1] == 1.0
    return float(component.noise_density[-1, -1]) if walks else 0.0


def _mode_in_steps(recipe: ModeRecipe, tuning: Tuning, step_s: float) -> Mode:
    density = float(np.float64(recipe.process_noise_density) * np.float64(step_s) ** (2 * recipe.order - 1))
    variance = float(np.float64(recipe.noise_std) ** 2)
    if not (_LEAST < variance < _GREATEST and density / variance < _GREATEST_RATIO):
        raise ModelError(
            f"mode {recipe.name!r} has process_noise_density = {recipe.process_noise_density:.3g} and noise_std ="
            f" {recipe.noise_std:.3g}: out of range; correct one, or choose a unit in which noise_std is nearer 1."
        )
    damping = 0.0 if recipe.damped_below_hz is None else 2 * np.pi * recipe.damped_below_hz * step_s
    component = returning_motion(recipe.order, density, damping) if damping else motion(recipe.order, density)
    if recipe.with_tones:
        component = sum(tuning.companions, component)
    if recipe.level_noise_density > 0:
        component = with_walking_level(component, recipe.level_noise_density * step_s)
    return Mode(recipe.name, component, variance, recipe.lasts_s / step_s, recipe.then, recipe.wild_share)


_NOTHING_REMOVED = 0.8
"""Noise gain from which on a filter counts as one that removes next to no noise."""


class Figures(NamedTuple):
    """The figures of a filter; attributes as in `ChannelReport`.

    For a filter with a fixed lag, bandwidth_hz, lag_s and independence_s are None.
    """

    bandwidth_hz: float | None = None
    lag_s: float | None = None
    independence_s: float | None = None
    modes: dict[str, ModeReport] = {}  # noqa: RUF012  (never changed)
    noise_gain: float | None = None  # None for a filter with modes or without a steady state

    @property
    def removes_nothing(self) -> bool:
        """Return whether the filter is known to remove next to no noise."""
        return self.noise_gain is not None and self.noise_gain >= _NOTHING_REMOVED

    @property
    def removes_noise(self) -> bool:
        """Return whether the filter is known to remove noise."""
        return self.noise_gain is not None and self.noise_gain < _NOTHING_REMOVED


def fixed_figures(tuning: Tuning, step_s: float, lag: int | None) -> Figures:
    """Return the figures of a fixed filter; `lag` in rows: 0 for a causal filter, None for a smoother."""
    response = _response(tuning.component, tuning.noise_variance, step_s, causal=lag is not None)
    gain = None if response is None else response.noise_gain
    if lag:
        return Figures(noise_gain=gain)
    steps = independence_steps(tuning, lag == 0)
    independent = None if steps is None else steps * step_s
    if response is None:
        return Figures(None if tuning.tones else 0.0, None, independent)
    return Figures(response.bandwidth_hz, response.lag_s, independent, noise_gain=gain)


def mode_figures(switching: InteractingModels, shares: dict[str, float], step_s: float, lag: int | None) -> Figures:
    """Return the figures of each mode of an IMM; `shares` has the mean probability of each mode, by its name."""
    modes = {}
    for mode in switching.modes:
        response = _response(mode.component, mode.noise_variance, step_s, causal=lag is not None)
        report = ModeReport(shares[mode.name])
        if response is not None and not lag:
            left = float(np.sqrt(response.noise_gain * mode.noise_variance))
            lag_s = response.lag_s if np.isfinite(response.lag_s) else None
            report = ModeReport(shares[mode.name], response.bandwidth_hz, lag_s, left)
        modes[mode.name] = report
    return Figures(modes=modes)


def response_of(channel: ChannelRecipe, report: ChannelReport, step_s: float, causal: bool) -> Response | None:
    """Return the response of a channel's filter; for a filter with modes, that of the most probable mode.

    Returns
    -------
    Response or None
        None for a channel that passes unchanged, or a filter without a steady state.
    """
    if channel.motion is None:
        return None
    tuning, own = in_steps(channel.motion, step_s), channel.own_steps(step_s)
    if channel.switching is None:
        return fixed_response(tuning.counted_in(own), step_s * own, causal)
    modes = {mode.name: mode for mode in modes_in_steps(channel.switching, tuning, step_s).modes}
    most = modes[max(report.modes, key=lambda name: report.modes[name].share)]
    return _response(most.component, most.noise_variance, step_s, causal=causal)


def fixed_response(tuning: Tuning, step_s: float, causal: bool) -> Response | None:
    """Return the response of a fixed filter; None if it has no steady state."""
    return _response(tuning.component, tuning.noise_variance, step_s, causal=causal)


def _response(component: Component, noise_variance: float, step_s: float, *, causal: bool) -> Response | None:
    """Return the response of a filter; None if it never forgets its start, so that it has no steady state."""
    try:
        return describe(component.to_model(1.0, noise_variance), step_s, causal, component.signal_output[0])
    except ModelError:
        return None
