"""clean(recording, recipe) -> Cleaned: the main job."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.recipe import Recipe
from becalm.cleaning.report import ChannelReport
from becalm.cleaning.tuning import Wishes, listed, refuse_causal_lag, refuse_empty, tune
from becalm.core.arrays import Codes
from becalm.core.recording import Recording
from becalm.core.rows import EstimatedRows
from becalm.errors import RecipeError


@dataclass(frozen=True)
class Cleaned:
    """A cleaned recording.

    Attributes
    ----------
    signal : Recording
        The clean channels, (N, m), same names, units and times.
    sigma : Recording
        One standard uncertainty of each sample, same units; NaN where none can be told.
    recipe : Recipe
        What was decided, enough to do it again.
    reports : tuple of ChannelReport
        What was found for each channel, and whether to trust it.
    parts : Recording or None
        What each channel was split into, (N, p), where it was asked for: "ax_motion", "ax_tone_50Hz".
    verdicts : dict of str to (N,) int8 array
        What became of each reading of each channel: values of `becalm.core.verdict.Verdict`.
    """

    signal: Recording
    sigma: Recording
    recipe: Recipe
    reports: tuple[ChannelReport, ...]
    parts: Recording | None = None
    verdicts: dict[str, Codes] = field(default_factory=dict)

    @property
    def describes(self) -> bool:
        """Whether every channel is described by its model."""
        return all(report.describes for report in self.reports)


def clean(  # noqa: PLR0913  (what is wanted, each by its name)
    recording: Recording,
    recipe: Recipe | None = None,
    *,
    causal: bool | None = None,
    lag_s: float | None = None,
    channels: Sequence[str] | None = None,
    split: bool = False,
) -> Cleaned:
    """Clean a recording, by a recipe or by one found in it.

    Parameters
    ----------
    recording : Recording
        Samples (N, m), NaN where missing. Never modified.
    recipe : Recipe, optional
        What to do; `tune(recording)` by default.
    causal : bool, optional
        Whether estimates know only the past; False by default, or as the recipe says. A recipe tuned
        for the other mode keeps its numbers, which `tune(..., causal=...)` might choose differently.
    lag_s : float, optional
        How long each estimate may wait for later readings, in place of none or all of them; with a *small*
        one a live filter of this kind tells the signal soon, and noisier.
    channels : sequence of str, optional
        Names of the channels to clean; all, or all of the recipe, by default.
    split : bool
        Whether to return the parts of each channel too: motion, tones, coloured noise.

    Raises
    ------
    RecordingError
        If a channel does not exist, or there are no channels or samples.
    RecipeError
        If the recipe is none, or names a channel that the recording does not have, or in another unit.
    UsageError
        If a lag is asked of a causal filter, or no later reading comes within it.
    """
    refuse_empty(recording)
    if not (recipe is None or isinstance(recipe, Recipe)):
        raise RecipeError(f"A Recipe is needed; {recipe!r:.60} came. Load one: becalm.Recipe.load('recipe.toml').")
    if recipe is None:
        recipe = tune(recording, causal=bool(causal), channels=channels, wishes=Wishes(lag_s=lag_s))
    else:
        recipe = fitted(in_mode(recipe, causal, lag_s), recording.names, recording.units, channels=channels)
    chosen = recording.select([channel.name for channel in recipe.channel])
    refuse_empty(chosen)
    time = chosen.timebase
    with Cleaner(recipe, time.step_s, split=split) as cleaner:
        columns = [np.ascontiguousarray(chosen.channel(name)) for name in chosen.names]
        (told,) = [*cleaner.push(columns, time.elapsed_steps), *cleaner.finish()]
        reports = cleaner.reports()
    return Cleaned(
        chosen.with_samples(np.column_stack([channel.signal for channel in told])),
        chosen.with_samples(np.column_stack([channel.sigma for channel in told])),
        recipe,
        reports,
        _parts(chosen, recipe, told) if split else None,
        {name: channel.verdicts for name, channel in zip(chosen.names, told, strict=True)},
    )


def _parts(recording: Recording, recipe: Recipe, told: Sequence[EstimatedRows]) -> Recording:
    """Lay out the parts of each channel, as channels of their own."""
    names = [(channel.name, part) for channel in recipe.channel for part in channel.parts]
    units = dict(zip(recording.names, recording.units, strict=True))
    return Recording(
        np.vstack([channel.parts for channel in told]).T,
        names=[f"{name}_{part}" for name, part in names],
        units=[units[name] for name, _ in names],
        timebase=recording.timebase,
    )


def in_mode(recipe: Recipe, causal: bool | None = None, lag_s: float | None = None) -> Recipe:
    """Return a recipe whose estimates know only the past, or as much more as is asked; as it is, if nothing is.

    Parameters
    ----------
    recipe : Recipe
        What to do; its filters stay.
    causal : bool, optional
        Whether estimates shall know only the past (True), or the whole record.
    lag_s : float, optional
        How long each estimate shall wait for later readings; with a *small* one it comes soon, and noisier.

    Raises
    ------
    UsageError
        If a lag is asked of a causal filter.
    """
    refuse_causal_lag(causal, lag_s)
    if lag_s is not None:
        return recipe.model_copy(update={"mode": "lagged", "lag_s": lag_s})
    if causal is None:
        return recipe
    return recipe.model_copy(update={"mode": "causal" if causal else "smoothed", "lag_s": None})


def joined(recipes: Sequence[Recipe]) -> Recipe:
    """Return one recipe for the channels of several recordings: of the first, all else.

    Parameters
    ----------
    recipes : sequence of Recipe
        One or more, of different channels.
    """
    return recipes[0].model_copy(update={"channel": tuple(channel for recipe in recipes for channel in recipe.channel)})


def _narrowed(recipe: Recipe, channels: Sequence[str] | None) -> Recipe:
    if channels is None:
        return recipe
    known = {channel.name: channel for channel in recipe.channel}
    missing = [name for name in listed(channels) if name not in known]
    if missing:
        raise RecipeError(f"The recipe has no channel {missing[0]!r}; it has {', '.join(map(repr, known))}.")
    return recipe.model_copy(update={"channel": tuple(known[name] for name in listed(channels))})


def fitted(
    recipe: Recipe,
    names: Sequence[str],
    units: Sequence[str],
    *,
    channels: Sequence[str] | None = None,
) -> Recipe:
    """Return a recipe for a recording of these names and units.

    Parameters
    ----------
    recipe : Recipe
        What to do.
    names, units : sequence of str
        What the recording has.
    channels : sequence of str, optional
        Which of the recipe's channels to clean; all by default.

    Raises
    ------
    RecipeError
        If the recipe names a channel that the recording does not have, or in another unit.
    """
    recipe = _narrowed(recipe, channels)
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
                f" {unit or 'no unit'!r}. Convert or tell it (a file's by --unit {wanted!r}), or tune a recipe on this"
                " recording."
            )
    return recipe
