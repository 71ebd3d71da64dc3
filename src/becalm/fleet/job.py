"""What a job over a lake is to do, as every task knows it."""

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
"""Of a stretch of a long sensor, where nothing else is said: seconds of work, and hundreds of megabytes of files."""


class Sensor(NamedTuple):
    """A sensor of a lake."""

    name: str  # the path of its folder, or file, within the lake
    bytes: int  # of its files
    recipe: str  # the hash of its recipe
    files: tuple[str, ...] = ()  # paths within the lake, where they are not all that is in one place
    came_of: str = ""  # the hash of what its output comes of, where its files do not tell


@dataclass(frozen=True)
class Job:
    """What is to be done.

    Attributes
    ----------
    lake, output : str
        Folders that every worker sees under these paths.
    recipes : mapping of str to str
        Texts of recipes by their hashes.
    by : {"folder", "file"}
        What tells a sensor.
    causal : bool or None
        Whether estimates know only the past; None for as each recipe says.
    stretch_rows : int
        A sensor of twice as many is cut in time, into stretches of so many.
    another : str
        What makes another recipe, to type.
    own : str
        What no other job has: a sensor that it finished is not of an earlier one, though a worker died since.
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
        """Look into the files of a sensor.

        Raises
        ------
        InputError
            If they cannot be read, or are no one recording.
        """
        if sensor.files:
            return (read_folder(Path(self.lake), self.files_of(sensor)),)
        return read_tables(self.input_of(sensor))

    def name_of(self, sensor: Sensor, file: Path) -> str:
        """Return what a file of a sensor is called within the folder of its output."""
        if sensor.files:
            return below(sensor.name, file.relative_to(self.lake))
        place = self.input_of(sensor)
        return file.relative_to(place.parent if self.by == FILE else place).as_posix()

    def output_folder(self, sensor: Sensor) -> Path:
        """Return the folder that its output goes to."""
        place = Path(self.output) / sensor.name
        return place.parent if self.by == FILE else place

    def mark_of(self, sensor: Sensor) -> Path:
        """Return where it is said that its output is complete."""
        alone = f"{Path(sensor.name).name}." if self.by == FILE else ""
        return self.output_folder(sensor) / f"_{alone}{MARK}"

    def recipe_of(self, sensor: Sensor) -> Recipe:
        """Return what to do with a sensor.

        Raises
        ------
        RecipeError
            If its recipe is damaged.
        """
        return in_mode(_parsed(self.recipes[sensor.recipe]), self.causal)

    @property
    def asked(self) -> dict[str, Any]:
        """What changes outputs, beside their recipes."""
        return {"causal": self.causal}


@lru_cache
def _parsed(text: str) -> Recipe:
    """Read a recipe, which many sensors may have, once."""
    return Recipe.from_toml(text)
