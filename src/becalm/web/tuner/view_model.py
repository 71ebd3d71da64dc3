"""The view model of the tuner: the open recording and the settings of its channels, with undo."""

from __future__ import annotations

from typing import NamedTuple

from becalm.classic.register import CAUSAL, ZERO_PHASE
from becalm.cleaning.recipes.recipe import ChannelRecipe, Mode, Recipe
from becalm.cleaning.recipes.steps import lag_in_rows
from becalm.errors import RecipeError, UsageError
from becalm.web.tuner.messages import SettingChanges
from becalm.web.tuner.naming import command
from becalm.web.tuner.opened import OpenRecording
from becalm.web.tuner.settings import GIVEN, Options, Setting, components

_MOST_STEPS = 1000  # limit of the changes that can be undone
_MOST_WAITED = 10_000_000_000  # largest product of rows and lag in rows, for which a picture takes about ten seconds


class TunerSettings(NamedTuple):
    """The mode, its lag, and the settings of all channels."""

    mode: Mode
    lag_s: float | None
    settings: tuple[Setting, ...]


class ViewModel:
    """A recording and the settings of its filters.

    Parameters
    ----------
    opened : OpenRecording
        Open recording.
    mode : {"causal", "smoothed", "lagged"}
        Mode at the start.
    """

    def __init__(self, opened: OpenRecording, mode: Mode = "smoothed") -> None:
        self.opened = opened
        first = TunerSettings(mode, None, (Setting(),) * len(opened.recording.names))
        self._steps, self._at, self._dragged = [first], 0, first

    @property
    def now(self) -> TunerSettings:
        """Return the present settings, including changes of a drag that is not finished."""
        return self._dragged

    @property
    def lag(self) -> int | None:
        """Return the lag in rows: 0 for a causal filter, None for a smoother."""
        mode, lag_s, _ = self.now
        if mode == "lagged" and lag_s is not None:
            return lag_in_rows(lag_s, self.opened.step_s)
        return None if mode == "smoothed" else 0

    @property
    def options(self) -> tuple[Options, ...]:
        """Return the possible settings of each channel in the present mode."""
        return self._options_in(self.now)

    @property
    def can_undo(self) -> bool:
        """Return whether a change can be undone."""
        return self._at > 0

    @property
    def can_redo(self) -> bool:
        """Return whether an undone change can be redone."""
        return self._at + 1 < len(self._steps)

    @property
    def classics(self) -> list[str]:
        """Return the names of the classic filters that can be compared in the present mode."""
        return classics_of(self.now.mode)

    def begin(self) -> None:
        """Identify the filters, which takes a while."""
        self.opened.options(self.opened.as_filter(self.now.mode, self.now.lag_s))

    def turn(self, channel: int, changes: SettingChanges, *, final: bool) -> None:
        """Change the settings of a channel; a change that is not final is not a step for undo."""
        options = self._options_of(channel)
        setting = options.changed(self.now.settings[channel], changes)
        settings = list(self.now.settings)
        settings[channel] = setting
        self._set(self.now._replace(settings=tuple(settings)), final=final)

    def set_mode(self, mode: Mode, lag_s: float | None) -> None:
        """Set the mode: smoother, causal filter, or fixed lag. The first call takes a while: it identifies filters.

        Raises
        ------
        UsageError
            If the lag is shorter than one step, or so long that a picture would take more than about ten seconds.
        """
        self._refuse_endless(mode, lag_s)
        self.opened.options(self.opened.as_filter(mode, lag_s))
        self._set(self.now._replace(mode=mode, lag_s=lag_s))

    def undo(self) -> None:
        """Undo the last change."""
        self._at = max(self._at - 1, 0)
        self._dragged = self._steps[self._at]

    def redo(self) -> None:
        """Redo the change that was undone last."""
        self._at = min(self._at + 1, len(self._steps) - 1)
        self._dragged = self._steps[self._at]

    def restore(self, text: str) -> None:
        """Set all filters as in a recipe.

        Raises
        ------
        RecipeError
            If the text is not a recipe, or the recipe does not fit this recording.
        UsageError
            If the lag of the recipe is too short or too long, as in `set_mode`.
        """
        recipe = Recipe.from_toml(text)
        self._refuse_endless(recipe.mode, recipe.lag_s)
        given = {channel.name: channel for channel in recipe.channel}
        names = self.opened.recording.names
        if unknown := [name for name in given if name not in names]:
            raise RecipeError(f"The recipe cleans {unknown[0]!r}, which this recording does not have.")
        options = self.opened.options(self.opened.as_filter(recipe.mode, recipe.lag_s))
        for channel, option in given.items():
            unit = self.opened.recording.units[names.index(channel)]
            if option.unit != unit:
                raise RecipeError(f"The recipe has {channel!r} in {option.unit!r}, this recording in {unit!r}.")
        settings = tuple(
            option.simplest_setting(given[name]) if name in given else Setting(unchanged=True)
            for name, option in zip(names, options, strict=True)
        )
        self._set(TunerSettings(recipe.mode, recipe.lag_s, settings))

    def channel(self, channel: int) -> ChannelRecipe:
        """Return the present recipe of a channel."""
        return self._options_of(channel).recipe(self.now.settings[channel])

    def setting_message(self, channel: int) -> list[object]:
        """Return the mode, its lag and the settings of a channel, as a part of messages to a page."""
        mode, lag_s, settings = self.now
        return [mode, lag_s, self._options_of(channel).as_dict(settings[channel])]

    def recipe(self) -> Recipe:
        """Return the recipe of all channels that are cleaned.

        Raises
        ------
        UsageError
            If all channels pass unchanged.
        """
        now = self.now
        recipe = self._recipe_of(now)
        pairs = zip(recipe.channel, now.settings, strict=True)
        kept = tuple(channel for channel, setting in pairs if not setting.unchanged)
        if not kept:
            raise UsageError("No channel is left to clean; switch the filter of one on before you save.")
        return recipe.model_copy(update={"channel": kept})

    def recipe_of_all(self) -> Recipe:
        """Return the recipe of all channels, including those that pass unchanged."""
        return self._recipe_of(self.now)

    def recording_message(self) -> dict[str, object]:
        """Return the message that describes the recording."""
        opened, now = self.opened, self.now
        mode, lag_s, settings = now
        names = zip(opened.recording.names, opened.recording.units, self._options_in(now), settings, strict=True)
        return {
            "kind": "recording",
            "file": opened.id,
            "name": opened.path.name,
            "group": opened.group,
            "groups": opened.groups,
            "rows": len(opened.recording),
            "rate_hz": opened.recording.rate_hz,
            "rate_said_hz": opened.read_options.rate_hz,
            "lasts_s": opened.lasts_s,
            "mode": mode,
            "lag_s": lag_s,
            "channels": [_description(name, unit, option, setting) for name, unit, option, setting in names],
            "classics": self.classics,
            "remarks": opened.remarks,
            "command": command(opened.path, opened.group if opened.has_several_groups else None),
        }

    def state_message(self) -> dict[str, object]:
        """Return the message with all settings."""
        now = self.now
        mode, lag_s, settings = now
        try:
            recipe = self.recipe().to_toml()
        except UsageError:
            recipe = ""
        return {
            "kind": "state",
            "mode": mode,
            "lag_s": lag_s,
            "can_undo": self.can_undo,
            "can_redo": self.can_redo,
            "changed": self.now != self._steps[0],
            "recipe": recipe,
            "channels": [option.as_dict(one) for option, one in zip(self._options_in(now), settings, strict=True)],
            "classics": self.classics,
        }

    def _refuse_endless(self, mode: Mode, lag_s: float | None) -> None:
        if mode != "lagged" or lag_s is None:
            return
        step_s, rows = self.opened.step_s, len(self.opened.recording)
        if lag_in_rows(lag_s, step_s) * rows > _MOST_WAITED:
            most_s = max(_MOST_WAITED // rows, 1) * step_s
            raise UsageError(
                f"A lag of {lag_s:g} s is too long to be drawn for {rows} rows; give at most {most_s:.3g} s, or"
                f" type becalm clean FILE -o OUT --lag {lag_s:g}s."
            )

    def _recipe_of(self, now: TunerSettings) -> Recipe:
        mode, lag_s, settings = now
        pairs = zip(self._options_in(now), settings, strict=True)
        channels = tuple(option.recipe(setting) for option, setting in pairs)
        origin = self.opened.origin(self.opened.as_filter(mode, lag_s))
        time, rate_hz = self.opened.read_options.time, self.opened.read_options.rate_hz
        return Recipe(mode=mode, lag_s=lag_s, time=time, rate_hz=rate_hz, tuned_on=origin, channel=channels)

    def _options_in(self, now: TunerSettings) -> tuple[Options, ...]:
        return self.opened.options(self.opened.as_filter(now.mode, now.lag_s))

    def _options_of(self, channel: int) -> Options:
        self.opened.check_channel(channel)
        return self.options[channel]

    def _set(self, settings: TunerSettings, *, final: bool = True) -> None:
        self._dragged = settings
        if final and settings != self._steps[self._at]:
            self._steps = [*self._steps[max(0, self._at + 1 - _MOST_STEPS) : self._at + 1], settings]
            self._at = len(self._steps) - 1


def classics_of(mode: Mode) -> list[str]:
    """Return the names of the classic filters that can be compared with a mode; none for a fixed lag."""
    if mode == "lagged":
        return []
    return [classic.name for classic in (CAUSAL if mode == "causal" else ZERO_PHASE)]


def _description(name: str, unit: str, options: Options, setting: Setting) -> dict[str, object]:
    given = setting.given
    also = [] if given is None else [{"key": GIVEN, "name": "as in the recipe", "evidence": "", "order": given.order}]
    shown = components(options.channel) | ({} if given is None else components(given))
    return {
        "name": name,
        "unit": unit,
        "choices": [*options.choices, *also],
        "components": [{"key": key, "name": text, "on": True} for key, text in shown.items()],
    }
