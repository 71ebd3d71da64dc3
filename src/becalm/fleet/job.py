"""Describe a job over a lake: its folders, recipes and options. Every task receives this description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from secrets import token_hex
from typing import Any, NamedTuple

from becalm.cleaning.pipeline import in_mode
from becalm.cleaning.recipe import Recipe
from becalm.files.lake.folder import read_folder
from becalm.files.lake.listing import parquet_files
from becalm.files.lake.marks import MARK
from becalm.files.registry import read_tables
from becalm.files.source import RawTable
from becalm.fleet.lake import FILE, FOLDER
from becalm.fleet.names import below

STRETCH_ROWS = 1 << 23
"""Default number of rows of a stretch of a long sensor: seconds of work, and hundreds of megabytes of files."""


class Sensor(NamedTuple):
    """A sensor of a lake."""

    name: str  # the path of its folder, or file, within the lake
    bytes: int  # total size of its files
    recipe: str  # the hash of its recipe
    files: tuple[str, ...] = ()  # paths within the lake; empty if they are all files of its folder
    came_of: str = ""  # the hash of its input, if that cannot be computed from its files alone


@dataclass(frozen=True)
class Job:
    """A job over a lake.

    Attributes
    ----------
    lake, output : str
        Folders that every worker sees under these paths.
    recipes : mapping of str to str
        TOML texts of recipes by their hashes.
    by : {"folder", "file"}
        What identifies a sensor.
    causal : bool or None
        Whether estimates use only the past; None to do what each recipe says.
    stretch_rows : int
        Least number of rows of a stretch. Only a sensor with at least twice as many is cut in time.
    another : str
        The command that makes another recipe, for messages.
    own : str
        A random identifier of this job. A completion mark contains it, and so shows whether this job or an earlier one
        finished a sensor, even if the worker died afterwards.
    """

    lake: str
    output: str
    recipes: Mapping[str, str]
    by: str = FOLDER
    causal: bool | None = None
    stretch_rows: int = STRETCH_ROWS
    another: str = "becalm fleet tune LAKE -o DIR"
    own: str = field(default_factory=token_hex)

    def input_of(self, sensor: Sensor) -> Path:
        """Return the folder, or the one file, of a sensor."""
        return Path(self.lake) / sensor.name

    def files_of(self, sensor: Sensor) -> list[Path]:
        """Return the files of a sensor.

        Raises
        ------
        InputError
            If they cannot be listed.
        """
        if sensor.files:
            return [Path(self.lake) / file for file in sensor.files]
        place = self.input_of(sensor)
        return list(parquet_files(place).files) if place.is_dir() else [place]

    def tables_of(self, sensor: Sensor) -> tuple[RawTable, ...]:
        """Read the tables of a sensor: names and types of columns, not yet the samples.

        Raises
        ------
        InputError
            If they cannot be read, or do not form one recording.
        """
        if sensor.files:
            return (read_folder(Path(self.lake), self.files_of(sensor)),)
        return read_tables(self.input_of(sensor))

    def name_of(self, sensor: Sensor, file: Path) -> str:
        """Return the name of a sensor's file within its output folder."""
        if sensor.files:
            return below(sensor.name, file.relative_to(self.lake))
        place = self.input_of(sensor)
        return file.relative_to(place.parent if self.by == FILE else place).as_posix()

    def output_folder(self, sensor: Sensor) -> Path:
        """Return the output folder of a sensor."""
        place = Path(self.output) / sensor.name
        return place.parent if self.by == FILE else place

    def mark_of(self, sensor: Sensor) -> Path:
        """Return the path of the completion mark of a sensor."""
        alone = f"{Path(sensor.name).name}." if self.by == FILE else ""
        return self.output_folder(sensor) / f"_{alone}{MARK}"

    def recipe_of(self, sensor: Sensor) -> Recipe:
        """Return the recipe of a sensor, in the job's mode.

        Raises
        ------
        RecipeError
            If its recipe is damaged.
        """
        return in_mode(_parsed(self.recipes[sensor.recipe]), self.causal)

    @property
    def asked(self) -> dict[str, Any]:
        """Return the options that change outputs, besides the recipes."""
        return {"causal": self.causal}


@lru_cache
def _parsed(text: str) -> Recipe:
    """Parse a recipe once, because many sensors may share it."""
    return Recipe.from_toml(text)
