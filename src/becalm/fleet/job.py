"""Describe a job over a lake: its folders, recipes and options. Every task receives this description."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from secrets import token_hex
from typing import Any, NamedTuple

from becalm.cleaning.pipeline import in_mode
from becalm.cleaning.recipes.recipe import Recipe
from becalm.files.lake.folder import read_folder
from becalm.files.lake.listing import parquet_files
from becalm.files.lake.marks import MARK
from becalm.files.registry import read_tables
from becalm.files.source import RawTable
from becalm.fleet.lake import FILE, FOLDER
from becalm.fleet.names import below

STRETCH_ROWS = 1 << 23
"""Default number of rows in a stretch of a long sensor: cleaning it takes seconds, and its files some 100 MB."""


class Sensor(NamedTuple):
    """A sensor of a lake."""

    name: str  # the path of its folder, or file, within the lake
    bytes: int  # total size of its files
    recipe: str  # the hash of its recipe
    files: tuple[str, ...] = ()  # paths of its files within the lake; empty if these are all files of its folder
    input_hash: str = ""  # the hash of its input; empty if `hash_input` can compute it from the sensor's own files


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
        Whether estimates use only the past; None for the mode of each recipe.
    stretch_rows : int
        Least number of rows of a stretch. Only a sensor with at least twice as many rows is cut in time.
    tune_command : str
        The command that makes a new recipe, for messages.
    job_id : str
        A random identifier of this job. Completion marks contain it; they show whether this job or an earlier job
        finished a sensor, even if the worker died afterwards.
    """

    lake: str
    output: str
    recipes: Mapping[str, str]
    by: str = FOLDER
    causal: bool | None = None
    stretch_rows: int = STRETCH_ROWS
    tune_command: str = "becalm fleet tune LAKE -o DIR"
    job_id: str = field(default_factory=token_hex)

    def input_of(self, sensor: Sensor) -> Path:
        """Return the folder, or the one file, of a sensor."""
        return Path(self.lake) / sensor.name

    def files_of(self, sensor: Sensor) -> list[Path]:
        """Return the input files of a sensor.

        Raises
        ------
        InputError
            If the files cannot be listed.
        """
        if sensor.files:
            return [Path(self.lake) / file for file in sensor.files]
        place = self.input_of(sensor)
        return list(parquet_files(place).files) if place.is_dir() else [place]

    def tables_of(self, sensor: Sensor) -> tuple[RawTable, ...]:
        """Read the headers of a sensor's tables: names and types of columns, no samples.

        Raises
        ------
        InputError
            If the files cannot be read, or do not form one recording.
        """
        if sensor.files:
            return (read_folder(Path(self.lake), self.files_of(sensor)),)
        return read_tables(self.input_of(sensor))

    def name_of(self, sensor: Sensor, file: Path) -> str:
        """Return the name, within the sensor's output folder, of the output file for an input file."""
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
            If the recipe is damaged.
        """
        return in_mode(_parsed(self.recipes[sensor.recipe]), self.causal)

    @property
    def asked(self) -> dict[str, Any]:
        """Return the options, besides the recipes, that change outputs."""
        return {"causal": self.causal}


@lru_cache
def _parsed(text: str) -> Recipe:
    """Parse a recipe. The result is cached, because many sensors may share a recipe."""
    return Recipe.from_toml(text)
