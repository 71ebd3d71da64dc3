"""Recipes on a disk that may change while a stream runs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from becalm.cleaning.recipe import Recipe
from becalm.errors import RecipeError
from becalm.fleet.names import folder_name, values_in
from becalm.fleet.recipes import DEFAULT, ENDING, recipes_in


@dataclass(frozen=True)
class LiveBook:
    """One recipe for all sensors, or a folder of them, looked at anew in every micro-batch.

    Attributes
    ----------
    path : Path
        A recipe; or a folder that holds `SENSOR.toml`, or `KEY=SENSOR.toml` as a batch over a lake has it, for each
        sensor that has its own, and `default.toml` for all others. Every worker must see it, on a disk they share.
    key : str
        The column that tells sensors apart.
    """

    path: Path
    key: str = "sensor"

    def recipe_for(self, sensor: str) -> Recipe:
        """Return what is to be done with a sensor, now.

        Raises
        ------
        RecipeError
            If there is none, or none that can be read.
        """
        if not self.path.is_dir():
            return _as_it_is(self.path)
        folder = folder_name(self.key, sensor)
        plain = [sensor] if sensor and Path(sensor).name == sensor else []
        for path in (self.path / f"{name}{ENDING}" for name in (*plain, folder, DEFAULT)):
            if _is_there(path):
                return _as_it_is(path)
        raise RecipeError(
            f"{self.path} has no recipe for {sensor!r}; add {folder}{ENDING}, or {DEFAULT}{ENDING} for all others."
        )

    def channels(self) -> tuple[str, ...]:
        """Return the channels of all recipes, now.

        Raises
        ------
        RecipeError
            If there is no recipe, or one cannot be read, or is where no sensor would find it.
        """
        paths = recipes_in(self.path) if self.path.is_dir() else [self.path]
        if lost := [path for path in paths if self.path.is_dir() and not self._is_found(path)]:
            raise RecipeError(
                f"{lost[0]} is of no sensor that {self.key!r} tells; a stream looks for SENSOR{ENDING},"
                f" {self.key}=SENSOR{ENDING} and {DEFAULT}{ENDING} in {self.path} itself. Move it there, or elsewhere."
            )
        if not paths:
            raise RecipeError(f"{self.path} holds no recipes; name one {DEFAULT}{ENDING}, or as its sensor.")
        names = [channel.name for path in paths for channel in _as_it_is(path).channel]
        return tuple(dict.fromkeys(names))

    def _is_found(self, path: Path) -> bool:
        keys = set(values_in(Path(path.name.removesuffix(ENDING))))
        return path.parent == self.path and keys <= {self.key}


def _is_there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # no file can have such a name
        return False


def _as_it_is(path: Path) -> Recipe:
    try:
        told = path.stat()
    except OSError:
        return Recipe.load(path)  # which says why it cannot
    return _read(path, told.st_mtime_ns, told.st_size)


@lru_cache(maxsize=4096)
def _read(path: Path, changed_ns: int, size: int) -> Recipe:
    """Read a recipe once for as long as its file is the same."""
    return Recipe.load(path)
