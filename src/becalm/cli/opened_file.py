"""Open a file with the options of the command line, and tune a recipe on it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from becalm.cli.options import split_names, units_of
from becalm.errors import UsageError

if TYPE_CHECKING:
    from becalm.cleaning.recipes.recipe import Recipe
    from becalm.cli.options import FilterOptions, TimeOptions
    from becalm.files.inputs.opening import OpenSource
    from becalm.files.inputs.time_bases import OpenFile
    from becalm.files.read_options import ReadOptions
    from becalm.sensors.record import SensorRecord

AS_WRITTEN, MENDED = "as-written", "mended"


class FileOptions(NamedTuple):
    """The options for reading a file."""

    channels: str | None
    rate_hz: float | None
    time: str | None
    recipe: Recipe | None = None
    group: str | None = None
    units: Mapping[str, str] = MappingProxyType({})
    sensors: tuple[SensorRecord, ...] = ()
    stamps: str | None = None

    def with_defaults_of(self, recipe: Recipe) -> FileOptions:
        """Return the options with a recipe, and with the recipe's time options if no rate and no time column is given.

        A given --stamps takes precedence over that of the recipe. With "as-written", the recipe's rate is ignored.
        """
        if self.rate_hz is None and self.time is None:
            rate_hz = None if self.stamps == AS_WRITTEN else recipe.rate_hz
            stamps = self.stamps or recipe.stamps
            return self._replace(rate_hz=rate_hz, time=recipe.time, stamps=stamps, recipe=recipe)
        return self._replace(recipe=recipe)

    def with_time_options(self, recipe: Recipe) -> Recipe:
        """Return the recipe with these time options, so that cleaning needs no other option for the same result."""
        return recipe.model_copy(update={"rate_hz": self.rate_hz, "time": self.time, "stamps": self._kept_stamps})

    @property
    def _kept_stamps(self) -> str | None:
        return AS_WRITTEN if self.stamps == AS_WRITTEN else None  # in a recipe, None means that stamps are repaired

    @property
    def names(self) -> tuple[str, ...] | None:
        """Return the channels to clean, or None for all."""
        if self.channels is None:
            return None if self.recipe is None else tuple(channel.name for channel in self.recipe.channel)
        names = split_names(self.channels)
        if not names:
            raise UsageError("--channels names no channel; write --channels NAME,NAME or leave it out.")
        return names


def read_file_options(
    channels: str | None, when: TimeOptions, units: list[str] | None, sensors: Path | None
) -> FileOptions:
    """Return the options for reading a file; print a warning for each sensor whose calibration is due.

    Raises
    ------
    UsageError
        If the value of --stamps is unknown, or units cannot be read.
    SensorError
        If the sensor file cannot be read.
    """
    if when.stamps not in (None, AS_WRITTEN, MENDED):
        raise UsageError(f"--stamps {when.stamps} is unknown; write --stamps {AS_WRITTEN} or --stamps {MENDED}.")
    records: tuple[SensorRecord, ...] = ()
    if sensors is not None:
        from datetime import datetime

        from becalm.cleaning.sensor_files.sensor_file import due_warnings, load_sensors
        from becalm.cli.messages import stderr

        records = load_sensors(sensors)
        for sentence in due_warnings(records, datetime.now().astimezone().date()):
            stderr.print(sentence)
    return FileOptions(channels, when.rate_hz, when.time, None, when.group, units_of(units), records, when.stamps)


def open_as(file: Path, file_options: FileOptions) -> OpenSource:
    """Open a file with these options, which select one time base."""
    from becalm.files.inputs.opening import open_source

    return open_source(file, _options(file, file_options))


def open_every(file: Path, file_options: FileOptions) -> AbstractContextManager[OpenFile]:
    """Open all time bases of a file with these options."""
    from becalm.files.inputs.time_bases import open_file

    return open_file(file, _options(file, file_options))


def _options(file: Path, file_options: FileOptions) -> ReadOptions:
    from becalm.files.read_options import COMMAND_LINE, ReadOptions, RequestOrigin, RequiredUnits

    origin = COMMAND_LINE
    if file_options.recipe is not None and file_options.channels is None:
        another = f"make another recipe with: becalm tune {file} -o R.toml"
        origin = RequestOrigin("The recipe", f" Choose some of its channels with --channels, or {another}")
    fitting = None
    if file_options.recipe is not None:
        needs = RequestOrigin("The recipe", f" Make another recipe with: becalm tune {file} -o R.toml")
        fitting = RequiredUnits(needs, {channel.name: channel.unit for channel in file_options.recipe.channel})
    kept = file_options.stamps == AS_WRITTEN
    return ReadOptions(
        file_options.time,
        file_options.rate_hz,
        file_options.names,
        origin,
        file_options.group,
        fitting,
        file_options.units,
        file_options.sensors,
        kept,
    )


def recipe_path_of(output: Path) -> Path:
    """Return the path of the recipe that belongs to an output."""
    return Path(f"{output}.recipe.toml")


def shown_name(file: Path) -> str:
    """Return the name of a file as text that UTF-8 can encode."""
    return os.fsencode(file.name).decode("utf-8", "replace")


def load(path: Path | None) -> Recipe | None:
    """Load a recipe; return None if there is no path."""
    if path is None:
        return None
    from becalm.cleaning.recipes.recipe import Recipe

    return Recipe.load(path)


def refuse_overwriting(file: Path, *outputs: Path) -> None:
    """Raise an error if an output would overwrite the input, or is a Parquet file inside an input folder.

    Raises
    ------
    UsageError
        If an output is the input, even by another path, or would later be read as a part of the input.
    """
    from becalm.files.parquet import PARQUET_ENDINGS

    for output in outputs:
        if is_same(output, file):
            raise UsageError(f"{output} is the input itself; raw data are never overwritten. Give another with -o.")
        is_table = output.name.lower().endswith(PARQUET_ENDINGS)
        if is_table and file.is_dir() and output.resolve().is_relative_to(file.resolve()):
            raise UsageError(f"{output} is in {file}, and would be read as a part of it. Give another with -o.")


def is_same(one: Path, other: Path) -> bool:
    """Return whether two paths are the same existing file or folder."""
    try:
        return one.samefile(other)
    except OSError:  # a path does not exist or is invalid; its later use reports why
        return False


def refuse_existing_columns(recipe: Recipe, columns: list[str], *, split: bool, verdicts: bool) -> None:
    """Raise an error if a file already has columns with the names of parts or verdicts to be written.

    Raises
    ------
    UsageError
        If the file has such a column.
    """
    parts = [f"{channel.name}_{part}" for channel in recipe.channel for part in channel.parts] if split else []
    verdict_columns = [f"{channel.name}_verdict" for channel in recipe.channel] if verdicts else []
    for option, written in (("--split", parts), ("--verdicts", verdict_columns)):
        if taken := [name for name in written if name in columns]:
            raise UsageError(
                f"The file has a column {taken[0]!r}, which {option} would write; rename it, or leave {option} out."
            )


def tuned(source: OpenSource, causal: bool, asked: FilterOptions, lag_s: float | None = None) -> Recipe:
    """Return a recipe tuned on a file, or on evenly spread stretches of a long file."""
    from becalm.cleaning.tuning import Wishes, calibrated, tune
    from becalm.cli.messages import progress
    from becalm.files.inputs.portions import explain_rest_errors, read_beginning, rows_to_tune_on

    sample = source.sample(rows_to_tune_on(source))
    rest = read_beginning(source) if asked.still_s else sample
    wishes = Wishes(
        asked.dial, asked.still_s, rest, asked.removed_hz, lag_s, asked.robust, asked.time_std_s, asked.fill
    )
    rests_named = explain_rest_errors(source, rest) if asked.still_s else nullcontext()
    with progress("tuning", len(source.names)) as step, rests_named:
        recipe = tune(sample, causal=causal, wishes=wishes, progress=lambda name: step(name, 1))
    origin = recipe.tuned_on.model_copy(update={"sha256": source.sha256()})
    channels = calibrated(recipe.channel, source.calibrations)
    return recipe.model_copy(update={"tuned_on": origin, "channel": channels})
