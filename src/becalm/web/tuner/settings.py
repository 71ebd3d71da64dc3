"""Define the settings of a channel's filter, and make recipes from them and from the identified recipe."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.steps import in_seconds, in_steps
from becalm.cleaning.tuning import ChannelTuning
from becalm.errors import UsageError
from becalm.identification.trust.tuning_spread import tuning_spread
from becalm.identification.wishes.dial import may_gate
from becalm.web.tuner.evidence import compared_with_best, describe_model
from becalm.web.tuner.messages import SettingChanges

FOUND, GIVEN = "found", "given"
"""Keys of two choices: the model that becalm chose, and the model of a recipe that the person loaded."""

_ORDER, _TONE = "order-", "tone-"


class Setting(NamedTuple):
    """The settings of a channel; None means the identified value."""

    choice: str = FOUND  # key of the model
    noise_std: float | None = None  # in unit
    process_noise_density: float | None = None  # in unit^2/s^(2 order - 1)
    off: frozenset[str] = frozenset()  # keys of the components that are switched off
    unchanged: bool = False  # whether the channel passes unchanged
    given: ChannelRecipe | None = None  # the recipe that the person loaded


class Options:
    """The possible settings of a channel, and the recipes that they make.

    Parameters
    ----------
    found : ChannelTuning
        Result of the identification, with the models that were compared.
    channel : ChannelRecipe
        Recipe of the chosen model, with the calibration of the sensor.
    step_s : float
        Sampling interval, in seconds.
    causal : bool
        Whether the channel was tuned as a filter, not as a smoother.
    """

    def __init__(self, found: ChannelTuning, channel: ChannelRecipe, step_s: float, causal: bool) -> None:
        self.channel, self._found, self._step_s, self._causal = channel, found, step_s, causal
        self._rivals = {f"{_ORDER}{rival.order}": rival for rival in found.choice.rivals}
        self._tuned: dict[str, ChannelRecipe] = {FOUND: channel}

    @cached_property
    def choices(self) -> list[dict[str, object]]:
        """Return the models to choose from, each with a sentence on how well it predicts readings."""
        chosen = {"key": FOUND, "name": f"becalm's choice: {describe_model(self.channel)}", "order": self.channel.order}
        evidence = compared_with_best(self._found.choice.rivals)
        return [
            {**chosen, "evidence": "" if self._rivals else "nothing else was tried"},
            *(
                {"key": key, "name": f"order {rival.order}", "evidence": evidence[rival.order], "order": rival.order}
                for key, rival in self._rivals.items()
            ),
        ]

    def changed(self, setting: Setting, changes: SettingChanges) -> Setting:
        """Return a setting with changes applied.

        Raises
        ------
        UsageError
            If there is no such choice or component, or the channel has no filter to set.
        """
        if changes.choice is not None:  # choosing the same model again restores its identified numbers
            self._refuse_unknown(changes.choice, setting)
            setting = setting._replace(choice=changes.choice, noise_std=None, process_noise_density=None)
        if changes.unchanged is not None:
            setting = setting._replace(unchanged=changes.unchanged)
        for key, on in (changes.on or {}).items():
            setting = self._switched(setting, key, on)
        return self._dialled(setting, changes)

    def recipe(self, setting: Setting) -> ChannelRecipe:
        """Return the channel's recipe for a setting; a channel that passes unchanged keeps only its sensor limits."""
        base = self._base(setting)
        if setting.unchanged:
            return ChannelRecipe(name=base.name, unit=base.unit, model="untold", limits=base.limits)
        recipe = _without(base, setting.off)
        dialled = setting.noise_std is not None or setting.process_noise_density is not None
        if not dialled or base.motion is None:
            return recipe if recipe == base or setting.choice == GIVEN else _without_alarms(recipe)
        noise_std = base.motion.noise_std if setting.noise_std is None else setting.noise_std
        density = setting.process_noise_density
        update: dict[str, object] = {
            "noise_std": noise_std,
            "process_noise_density": base.motion.process_noise_density if density is None else density,
            "tuning_spread": 0.0,  # numbers that a person sets are not estimates
            "switching": None,
        }
        if recipe.timing is not None:
            included = min(recipe.timing.included_std, noise_std)
            update["timing"] = recipe.timing.model_copy(update={"included_std": included})
        return _without_alarms(_with_fair_gate(recipe.model_copy(update=update), base, self._step_s))

    def as_dict(self, setting: Setting) -> dict[str, object]:
        """Return a setting as the part of a message to a page."""
        recipe, base = self.recipe(setting), self._base(setting)
        on = dict.fromkeys(components(self.channel), False)
        on |= {key: key not in setting.off for key in components(base)}
        for key in ("switching", "gate"):
            if key in on and getattr(recipe, key) is None:
                on[key] = False
        return {
            "choice": setting.choice,
            "order": recipe.order,
            "noise_std": recipe.noise_std,
            "process_noise_density": recipe.process_noise_density,
            "on": on,
            "unchanged": setting.unchanged or recipe.model != "motion",
        }

    def simplest_setting(self, given: ChannelRecipe) -> Setting:
        """Return the simplest setting whose recipe is a given recipe of the channel."""
        for choice in (FOUND, *self._rivals):
            base = self._base(Setting(choice))
            off = frozenset(key for key in components(base) if not _has(given, key, base))
            candidates = [Setting(choice, off=off)]
            if given.motion is not None:
                numbers = given.motion.noise_std, given.motion.process_noise_density
                candidates += [
                    Setting(choice, *numbers, off=off - kept) for kept in ({"switching", "gate"}, {"switching"})
                ]
            for setting in candidates:
                if self.recipe(setting) == given:
                    return setting
        return Setting(GIVEN, given=given)

    def _base(self, setting: Setting) -> ChannelRecipe:
        if setting.choice == GIVEN and setting.given is not None:
            return setting.given
        if setting.choice not in self._tuned:
            rival = self._rivals.get(setting.choice)
            if rival is None:  # the order was tried in the other mode only
                return self.channel
            spread = tuning_spread(rival, self._found.evidence, self._causal)
            rival_recipe = in_seconds(self.channel.name, self.channel.unit, rival, self._step_s, spread)
            shared = ("tone", "coloured_noise", "gate", "calibration", "limits", "timing")
            update = {key: getattr(self.channel, key) for key in shared}
            self._tuned[setting.choice] = _without_alarms(rival_recipe.model_copy(update=update))
        return self._tuned[setting.choice]

    def _refuse_unknown(self, choice: str, setting: Setting) -> None:
        if choice not in (FOUND, *self._rivals) and not (choice == GIVEN and setting.given is not None):
            raise UsageError(f"There is no model {choice!r} for {self.channel.name!r}; choose one from the list.")

    def _switched(self, setting: Setting, key: str, on: bool) -> Setting:
        if key not in components(self._base(setting)):
            if key not in components(self.channel):
                raise UsageError(f"{self.channel.name!r} has no component {key!r} to switch; reload the page.")
            if not on:  # for example, a model of one order has no modes to switch off
                return setting
            setting = setting._replace(choice=FOUND, noise_std=None, process_noise_density=None)
        if key in ("switching", "gate") and on:  # both are valid for the identified numbers only
            setting = setting._replace(noise_std=None, process_noise_density=None)
        return setting._replace(off=setting.off - {key} if on else setting.off | {key})

    def _dialled(self, setting: Setting, changes: SettingChanges) -> Setting:
        if changes.noise_std is None and changes.process_noise_density is None:
            return setting
        motion = self.recipe(setting._replace(unchanged=False)).motion
        if motion is None:
            raise UsageError(f"{self.channel.name!r} passes unchanged: it has no filter to set.")
        noise_std = motion.noise_std if changes.noise_std is None else changes.noise_std
        density = changes.process_noise_density
        density = motion.process_noise_density if density is None else density
        if (noise_std, density) == (motion.noise_std, motion.process_noise_density):
            return setting  # a page may send back the present values
        return setting._replace(noise_std=noise_std, process_noise_density=density)


def components(recipe: ChannelRecipe) -> dict[str, str]:
    """Return the components of a channel's filter that can be switched off: their names for people, by key."""
    named = {f"{_TONE}{k}": f"tone at {tone.frequency_hz:.4g} Hz" for k, tone in enumerate(recipe.tone)}
    if recipe.coloured_noise is not None:
        named["coloured"] = "coloured noise"
    if recipe.gate is not None:
        named["gate"] = "gate: rejects spikes"
    if recipe.switching is not None:
        named["switching"] = f"modes: {', '.join(mode.name for mode in recipe.switching.mode)}"
    if recipe.limits is not None:
        named["limits"] = "sensor limits: clipped and stuck readings"
    if recipe.timing is not None:
        named["timing"] = "uncertain time"
    return named


_FIELDS = {"coloured": "coloured_noise"} | {key: key for key in ("gate", "switching", "limits", "timing")}


def _has(recipe: ChannelRecipe, key: str, base: ChannelRecipe) -> bool:
    """Return whether a recipe has the component with this key; tones are numbered as in `base`."""
    if key in _FIELDS:
        return getattr(recipe, _FIELDS[key]) is not None
    return base.tone[int(key.removeprefix(_TONE))] in recipe.tone


def _without(recipe: ChannelRecipe, off: frozenset[str]) -> ChannelRecipe:
    update: dict[str, Any] = {_FIELDS[key]: None for key in off if key in _FIELDS}
    if any(key not in _FIELDS for key in off):
        update["tone"] = tuple(tone for k, tone in enumerate(recipe.tone) if f"{_TONE}{k}" not in off)
    return recipe.model_copy(update=update) if update else recipe


def _with_fair_gate(dialled: ChannelRecipe, base: ChannelRecipe, step_s: float) -> ChannelRecipe:
    """Return a recipe without its gate if the filter is slower, or its noise smaller, than in `base`."""
    if dialled.gate is None or dialled.motion is None or base.motion is None:
        return dialled
    if may_gate(in_steps(dialled.motion, step_s), in_steps(base.motion, step_s)):
        return dialled
    return dialled.model_copy(update={"gate": None})


def _without_alarms(recipe: ChannelRecipe) -> ChannelRecipe:
    """Return a recipe without drift and dead-sensor alarms: their thresholds hold for the identified filter only."""
    if recipe.limits is None:
        return recipe
    limits = recipe.limits.model_copy(update={"drift_threshold": None, "dead_variance": None})
    return recipe.model_copy(update={"limits": limits})
