"""tune(recording) -> Recipe and clean(recording, recipe) -> Cleaned: the main job."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version

import numpy as np

from becalm.cleaning.cleaner import Cleaner
from becalm.cleaning.judging import ChannelReport
from becalm.cleaning.recipe import ChannelRecipe, Origin, Recipe, ToneRecipe
from becalm.core.recording import Recording
from becalm.core.verdict import judge
from becalm.errors import RecipeError, RecordingError
from becalm.noise.choose import choose
from becalm.noise.dial import Dial, turn
from becalm.noise.spectrum import Line

Progress = Callable[[str], None]


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
    """

    signal: Recording
    sigma: Recording
    recipe: Recipe
    reports: tuple[ChannelReport, ...]

    @property
    def describes(self) -> bool:
        """Whether every channel is described by its model."""
        return all(report.describes for report in self.reports)


def tune(
    recording: Recording,
    *,
    causal: bool = False,
    channels: Sequence[str] | None = None,
    dial: Dial | None = None,
    progress: Progress | None = None,
) -> Recipe:
    """Identify the noise of each channel and choose its filter; nothing needs to be said.

    Parameters
    ----------
    recording : Recording
        Samples (N, m), NaN where missing.
    causal : bool
        Whether the recipe shall filter (True) or smooth.
    channels : sequence of str, optional
        Names of the channels to clean; all by default.
    dial : Dial, optional
        A lag, a bandwidth or a noise gain that every filter shall have; by default the recording decides.
    progress : callable, optional
        Called with a channel's name when it is done.

    Raises
    ------
    RecordingError
        If a channel does not exist, or there are no channels or samples.
    UsageError
        If no filter has what the dial asks.
    """
    _refuse_empty(recording)
    chosen = recording if channels is None else recording.select(_listed(channels))
    _refuse_empty(chosen)
    one = partial(_tune_channel, chosen, causal, dial, progress or _silent)
    pool = ThreadPoolExecutor()
    try:
        found = tuple(pool.map(one, chosen.names))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)  # who stops it need not wait for the others
    origin = Origin(rows=len(chosen), rate_hz=chosen.rate_hz, becalm=version("becalm"))
    return Recipe(mode="causal" if causal else "smoothed", tuned_on=origin, channel=found)


def clean(
    recording: Recording,
    recipe: Recipe | None = None,
    *,
    causal: bool | None = None,
    channels: Sequence[str] | None = None,
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
    channels : sequence of str, optional
        Names of the channels to clean; all, or all of the recipe, by default.

    Raises
    ------
    RecordingError
        If a channel does not exist, or there are no channels or samples.
    RecipeError
        If the recipe names a channel that the recording does not have, or in another unit.
    """
    _refuse_empty(recording)
    if recipe is None:
        recipe = tune(recording, causal=bool(causal), channels=channels)
    else:
        recipe = fitted(recipe, recording.names, recording.units, causal=causal, channels=channels)
    chosen = recording.select([channel.name for channel in recipe.channel])
    _refuse_empty(chosen)
    time = chosen.timebase
    with Cleaner(recipe, time.step_s) as cleaner:
        columns = [np.ascontiguousarray(chosen.channel(name)) for name in chosen.names]
        (told,) = [*cleaner.push(columns, time.elapsed_steps), *cleaner.finish()]
        reports = cleaner.reports()
    return Cleaned(
        chosen.with_samples(np.column_stack([channel.signal for channel in told])),
        chosen.with_samples(np.column_stack([channel.sigma for channel in told])),
        recipe,
        reports,
    )


def _tune_channel(
    recording: Recording, causal: bool, dial: Dial | None, progress: Progress, name: str
) -> ChannelRecipe:
    time, unit = recording.timebase, recording.units[recording.names.index(name)]
    choice = choose(judge(recording.channel(name)).readings, time.elapsed_steps, causal)
    progress(name)
    if choice.tuning is None or choice.motion is None:
        return ChannelRecipe(name=name, unit=unit, model=choice.kind)
    found = choice.tuning if dial is None else turn(choice.motion, dial, time.step_s, causal)
    density = found.ratio * found.noise_variance / time.step_s ** (2 * found.order - 1)
    return ChannelRecipe(
        name=name,
        unit=unit,
        model="motion",
        order=found.order,
        process_noise_density=density,
        noise_std=float(np.sqrt(found.noise_variance)),
        tone=tuple(_tone(line, time.step_s) for line in found.lines),
    )


def _tone(line: Line, step_s: float) -> ToneRecipe:
    return ToneRecipe(
        frequency_hz=line.angle / (2 * np.pi * step_s),
        bandwidth_hz=line.damping / (np.pi * step_s),
        process_noise_density=line.density / step_s,
    )


def _narrowed(recipe: Recipe, causal: bool | None, channels: Sequence[str] | None) -> Recipe:
    changes: dict[str, object] = {}
    if causal is not None:
        changes["mode"] = "causal" if causal else "smoothed"
    if channels is not None:
        known = {channel.name: channel for channel in recipe.channel}
        missing = [name for name in _listed(channels) if name not in known]
        if missing:
            raise RecipeError(f"The recipe has no channel {missing[0]!r}; it has {', '.join(map(repr, known))}.")
        changes["channel"] = tuple(known[name] for name in _listed(channels))
    return recipe.model_copy(update=changes)


def fitted(
    recipe: Recipe,
    names: Sequence[str],
    units: Sequence[str],
    *,
    causal: bool | None = None,
    channels: Sequence[str] | None = None,
) -> Recipe:
    """Return a recipe for a recording of these names and units.

    Parameters
    ----------
    recipe : Recipe
        What to do.
    names, units : sequence of str
        What the recording has.
    causal : bool, optional
        Whether estimates shall know only the past; as the recipe says by default.
    channels : sequence of str, optional
        Which of the recipe's channels to clean; all by default.

    Raises
    ------
    RecipeError
        If the recipe names a channel that the recording does not have, or in another unit.
    """
    recipe = _narrowed(recipe, causal, channels)
    for channel in recipe.channel:
        if channel.name not in names:
            raise RecipeError(
                f"The recipe cleans {channel.name!r}, but the recording has {', '.join(map(repr, names))}."
                " Name the channels to clean, or tune a recipe on this recording."
            )
        unit = units[list(names).index(channel.name)]
        if channel.unit != unit:
            raise RecipeError(
                f"The recipe has {channel.name!r} in {channel.unit or 'no unit'!r}, the recording in"
                f" {unit or 'no unit'!r}. Convert one of them, or tune a recipe on this recording."
            )
    return recipe


def _refuse_empty(recording: Recording) -> None:
    if not isinstance(recording, Recording):
        raise RecordingError(
            f"A Recording is needed; {type(recording).__name__} came. Make one: becalm.Recording(samples, rate_hz=...)."
        )
    if not recording.names:
        raise RecordingError("No channel is left to clean; name at least one.")
    if not len(recording):
        raise RecordingError("The recording has no samples.")


def _listed(channels: Sequence[str]) -> list[str]:
    return [channels] if isinstance(channels, str) else list(channels)


def _silent(_: str) -> None:
    """Say nothing."""
