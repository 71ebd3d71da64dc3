"""Clean a recording with a recipe; change the mode or the channels of a recipe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from becalm.cleaning.channels.report import ChannelReport
from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.recipes.steps import checked_lag_s
from becalm.cleaning.tuning import Wishes, as_list, refuse_causal_lag, refuse_empty, tune
from becalm.core.arrays import Codes
from becalm.core.recording import Recording
from becalm.core.rows import EstimatedRows
from becalm.errors import RecipeError, UsageError


@dataclass(frozen=True)
class Cleaned:
    """A cleaned recording.

    Attributes
    ----------
    signal : Recording
        The clean channels, (N, m), with the names, units and times of the recording.
    sigma : Recording
        Standard uncertainty (k = 1) of each sample, in the same units; NaN where it is unknown, inf before the first
        reading of a causal filter.
    recipe : Recipe
        Recipe that was used; it makes the cleaning repeatable.
    reports : tuple of ChannelReport
        Report of each channel, with whether to trust its result.
    parts : Recording or None
        Parts of all channels, (N, p), such as "ax_motion" and "ax_tone_50Hz"; None without `split`.
    verdicts : dict of str to (N,) int8 array
        Verdict on each reading, by the name of the channel: values of `becalm.core.reading_verdicts.Verdict`.
    """

    signal: Recording
    sigma: Recording
    recipe: Recipe
    reports: tuple[ChannelReport, ...]
    parts: Recording | None = None
    verdicts: dict[str, Codes] = field(default_factory=dict)

    @property
    def describes(self) -> bool:
        """Return whether the model of every channel describes its signal."""
        return all(report.describes for report in self.reports)


def clean(  # noqa: PLR0913  (keyword options of the main function)
    recording: Recording,
    recipe: Recipe | None = None,
    *,
    causal: bool | None = None,
    lag_s: float | None = None,
    channels: Sequence[str] | None = None,
    split: bool = False,
) -> Cleaned:
    """Clean a recording with a recipe that is given, or that is tuned on the recording.

    Parameters
    ----------
    recording : Recording
        Samples (N, m), NaN where missing. It is not modified.
    recipe : Recipe, optional
        The recipe; `tune(recording)` by default.
    causal : bool, optional
        Whether estimates use only the past; by default the mode of the recipe, or False. A recipe that was tuned
        for the other mode keeps its parameters; `tune(..., causal=...)` might choose different ones.
    lag_s : float, optional
        How long each estimate may wait for later readings, in seconds. By default an estimate uses no later readings
        (causal) or all of them (smoothed). With a *small* lag a live filter returns its estimates sooner, but they are
        noisier.
    channels : sequence of str, optional
        Names of the channels to clean; by default all, or all channels of the recipe.
    split : bool
        Whether to return the parts of each channel as well: motion, tones, coloured noise.

    Raises
    ------
    RecordingError
        If a channel does not exist, or there are no channels or samples.
    RecipeError
        If `recipe` is not a Recipe, or names a channel that the recording does not have, or has in another unit.
    UsageError
        If a causal filter is given a lag, or the lag is shorter than one step or too long.
    """
    refuse_empty(recording)
    refuse_causal_lag(causal, lag_s)
    if not (recipe is None or isinstance(recipe, Recipe)):
        raise RecipeError(f"A Recipe is needed; {recipe!r:.60} came. Load one: becalm.Recipe.load('recipe.toml').")
    if recipe is None:
        recipe = tune(recording, causal=bool(causal), channels=channels, wishes=Wishes(lag_s=lag_s))
    else:
        recipe = fit_to_recording(in_mode(recipe, causal, lag_s), recording.names, recording.units, channels=channels)
    chosen = recording.select([channel.name for channel in recipe.channel])
    refuse_empty(chosen)
    time = chosen.timebase
    with Cleaner(recipe, time.step_s, split=split) as cleaner:
        columns = [np.ascontiguousarray(chosen.channel(name)) for name in chosen.names]
        (estimates,) = [*cleaner.push(columns, time.elapsed_steps), *cleaner.finish()]
        reports = cleaner.reports()
    return Cleaned(
        chosen.with_samples(np.column_stack([channel.signal for channel in estimates])),
        chosen.with_samples(np.column_stack([channel.sigma for channel in estimates])),
        recipe,
        reports,
        _parts(chosen, recipe, estimates) if split else None,
        {name: channel.verdicts for name, channel in zip(chosen.names, estimates, strict=True)},
    )


def _parts(recording: Recording, recipe: Recipe, estimates: Sequence[EstimatedRows]) -> Recording:
    """Return the parts of each channel as separate channels."""
    names = [(channel.name, part) for channel in recipe.channel for part in channel.parts]
    units = dict(zip(recording.names, recording.units, strict=True))
    return Recording(
        np.vstack([channel.parts for channel in estimates]).T,
        names=[f"{name}_{part}" for name, part in names],
        units=[units[name] for name, _ in names],
        timebase=recording.timebase,
    )


def in_mode(recipe: Recipe, causal: bool | None = None, lag_s: float | None = None) -> Recipe:
    """Return a recipe in another mode: causal, lagged or smoothed; unchanged if no option is given.

    Parameters
    ----------
    recipe : Recipe
        The recipe; the parameters of its filters stay the same.
    causal : bool, optional
        Whether estimates use only the past (True), or the whole record (False).
    lag_s : float, optional
        How long each estimate waits for later readings, in seconds; with a *small* lag estimates are noisier.

    Raises
    ------
    UsageError
        If a causal filter is given a lag, or the lag is not a number above 0.
    """
    refuse_causal_lag(causal, lag_s)
    if lag_s is not None:
        lag_s = checked_lag_s(lag_s)
        if not lag_s > 0:
            raise UsageError(f"lag_s = {lag_s:.6g} is not a lag; give seconds above 0, as in lag_s=0.01.")
        return recipe.model_copy(update={"mode": "lagged", "lag_s": lag_s})
    if causal is None:
        return recipe
    return recipe.model_copy(update={"mode": "causal" if causal else "smoothed", "lag_s": None})


def join_recipes(recipes: Sequence[Recipe]) -> Recipe:
    """Return one recipe with the channels of several recipes; all other settings are those of the first recipe.

    Parameters
    ----------
    recipes : sequence of Recipe
        One or more recipes, for different channels.
    """
    return recipes[0].model_copy(update={"channel": tuple(channel for recipe in recipes for channel in recipe.channel)})


def _select_channels(recipe: Recipe, channels: Sequence[str] | None) -> Recipe:
    """Return the recipe with only the named channels (None: all), in the order of the names."""
    if channels is None:
        return recipe
    by_name = {channel.name: channel for channel in recipe.channel}
    missing = [name for name in as_list(channels) if name not in by_name]
    if missing:
        raise RecipeError(f"The recipe has no channel {missing[0]!r}; it has {', '.join(map(repr, by_name))}.")
    return recipe.model_copy(update={"channel": tuple(by_name[name] for name in as_list(channels))})


def fit_to_recording(
    recipe: Recipe,
    names: Sequence[str],
    units: Sequence[str],
    *,
    channels: Sequence[str] | None = None,
) -> Recipe:
    """Return a recipe with only the wanted channels, after checking that a recording has them in the right units.

    Parameters
    ----------
    recipe : Recipe
        The recipe.
    names, units : sequence of str
        Channel names and units of the recording.
    channels : sequence of str, optional
        Names of the recipe's channels to clean; all by default.

    Raises
    ------
    RecipeError
        If the recipe names a channel that the recording does not have, or has in another unit.
    """
    recipe = _select_channels(recipe, channels)
    for channel in recipe.channel:
        if channel.name not in names:
            raise RecipeError(
                f"The recipe cleans {channel.name!r}, but the recording has {', '.join(map(repr, names))}."
                " Name the channels to clean, or tune a recipe on this recording."
            )
        unit = units[list(names).index(channel.name)]
        if channel.unit != unit:
            wanted = f"{channel.name}={channel.unit or 'UNIT'}"
            raise RecipeError(
                f"The recipe has {channel.name!r} in {channel.unit or 'no unit'!r}, the recording in"
                f" {unit or 'no unit'!r}. Convert the channel, give its unit (for a file: --unit {wanted!r}), or tune a"
                " recipe on this recording."
            )
    return recipe
