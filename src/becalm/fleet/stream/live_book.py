"""Read recipes from a disk; while a stream runs, read changed recipes again."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from becalm.cleaning.recipes.recipe import Recipe
from becalm.errors import RecipeError
from becalm.fleet.names import folder_name, values_in
from becalm.fleet.recipes import DEFAULT, ENDING, recipes_in


@dataclass(frozen=True)
class LiveBook:
    """One recipe for all sensors, or a folder of recipes; every micro-batch checks them for changes.

    Attributes
    ----------
    path : Path
        A recipe file, or a folder of recipes. In a folder, the recipe of a single sensor is `SENSOR.toml`, or
        `KEY=SENSOR.toml` as for batch jobs over a lake; `default.toml` is for all other sensors. Every worker must be
        able to read this path, on a shared disk.
    key : str
        The column that identifies sensors.
    """

    path: Path
    key: str = "sensor"

    def recipe_for(self, sensor: str) -> Recipe:
        """Return the current recipe of a sensor.

        Raises
        ------
        RecipeError
            If there is no recipe, or it cannot be read.
        """
        if not self.path.is_dir():
            return _current(self.path)
        folder = folder_name(self.key, sensor)
        plain = [sensor] if sensor and Path(sensor).name == sensor else []
        for path in (self.path / f"{name}{ENDING}" for name in (*plain, folder, DEFAULT)):
            if _exists(path):
                return _current(path)
        raise RecipeError(
            f"{self.path} has no recipe for {sensor!r}; add {folder}{ENDING}, or {DEFAULT}{ENDING} for all others."
        )

    def channels(self) -> tuple[str, ...]:
        """Return the channels of all current recipes.

        Raises
        ------
        RecipeError
            If there is no recipe, or if a recipe cannot be read or has a path or name that no sensor uses.
        """
        paths = recipes_in(self.path) if self.path.is_dir() else [self.path]
        if lost := [path for path in paths if self.path.is_dir() and not self._is_usable(path)]:
            raise RecipeError(
                f"{lost[0]} is not a recipe that a sensor in {self.key!r} can have; a stream looks for SENSOR{ENDING},"
                f" {self.key}=SENSOR{ENDING} and {DEFAULT}{ENDING} in {self.path} itself. Move it there, or elsewhere."
            )
        if not paths:
            raise RecipeError(
                f"{self.path} holds no recipes; name a file {DEFAULT}{ENDING}, or after its sensor, SENSOR{ENDING}."
            )
        names = [channel.name for path in paths for channel in _current(path).channel]
        return tuple(dict.fromkeys(names))

    def _is_usable(self, path: Path) -> bool:
        keys = set(values_in(Path(path.name.removesuffix(ENDING))))
        return path.parent == self.path and keys <= {self.key}


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # the name is not a valid file name
        return False


def _current(path: Path) -> Recipe:
    try:
        status = path.stat()
    except OSError:
        return Recipe.load(path)  # raises an error with the reason
    return _read(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=4096)
def _read(path: Path, changed_ns: int, size: int) -> Recipe:
    """Read a recipe. The result is cached, so a file is read again only if it has changed."""
    return Recipe.load(path)
