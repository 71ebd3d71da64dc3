"""Which recipe each sensor has: one for all, or the nearest in a folder that is laid out as the lake is."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from becalm.cleaning.recipe import Recipe
from becalm.errors import RecipeError, UsageError

DEFAULT = "default"
"""Name of the recipe of all sensors that have none of their own, without its ending."""

ENDING = ".toml"
"""Of their files."""


class RecipeBook:
    """Recipes by the sensors that they are of.

    Parameters
    ----------
    texts : mapping of str to str
        TOML by paths within the lake: of a sensor, or of a folder of sensors; `DEFAULT` is of all others.
    source : str
        Where they come from, for messages.

    Attributes
    ----------
    by_hash : dict of str to str
        The texts by the SHA-256 of their bytes.
    names : tuple of str
        What they are called.
    """

    def __init__(self, texts: dict[str, str], source: str) -> None:
        self._source, self.names = source, tuple(sorted(texts))
        self._hashes = {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()}
        self.by_hash = {self._hashes[name]: text for name, text in texts.items()}

    @classmethod
    def of_one(cls, path: Path) -> RecipeBook:
        """Read the one recipe of all sensors.

        Raises
        ------
        RecipeError
            If it cannot be read, or is no recipe.
        """
        return cls({DEFAULT: Recipe.load(path).to_toml()}, str(path))

    @classmethod
    def of_folder(cls, folder: Path) -> RecipeBook:
        """Read a folder of recipes: `plant=3/sensor=17.toml`, `plant=3.toml`, `default.toml`.

        Raises
        ------
        RecipeError
            If it holds none, or one cannot be read.
        """
        if not folder.is_dir():
            raise RecipeError(f"{folder} is no folder; name one that holds recipes, or one recipe with --recipe.")
        found = recipes_in(folder)
        if not found:
            raise RecipeError(
                f"{folder} holds no recipes. Name one {DEFAULT}{ENDING}, or as the sensor that it is of,"
                f" sensor=17{ENDING}; or make them with: becalm fleet tune LAKE -o {folder}"
            )
        names = (path.relative_to(folder).as_posix().removesuffix(ENDING) for path in found)
        return cls({name: Recipe.load(path).to_toml() for name, path in zip(names, found, strict=True)}, str(folder))

    def name_for(self, sensor: str) -> str:
        """Return the name of a sensor's recipe: its own, else that of the nearest folder above, else `DEFAULT`."""
        path = PurePosixPath(sensor)
        names = map(str, (path, sensor.removesuffix(".parquet").removesuffix(".pq"), *path.parents))
        return next((name for name in names if name in self._hashes), DEFAULT)

    def hash_for(self, sensor: str) -> str | None:
        """Return the hash of a sensor's recipe; None where it has none."""
        return self._hashes.get(self.name_for(sensor))

    def unused(self, sensors: Iterable[str]) -> tuple[str, ...]:
        """Return the names of recipes, but `DEFAULT`, that none of some sensors has."""
        return tuple(sorted({*self.names} - {DEFAULT} - set(map(self.name_for, sensors))))

    def why_not(self, sensor: str) -> str:
        """Say what to do for a sensor that has no recipe."""
        own = "" if sensor == "." else f"{sensor}{ENDING}, or "  # all of the lake has no name
        return f"{self._source} has no recipe for it; add {own}{DEFAULT}{ENDING} for all others."


def recipes_in(folder: Path) -> list[Path]:
    """List the recipes of a folder, at any depth, but in no hidden one."""
    found = sorted(folder.rglob(f"*{ENDING}"))
    return [path for path in found if not any(part.startswith(".") for part in path.relative_to(folder).parts)]


def open_book(recipe: Path | None = None, recipes: Path | None = None) -> RecipeBook:
    """Read what was named: one recipe, or a folder of them.

    Raises
    ------
    UsageError
        If neither or both were.
    RecipeError
        If they cannot be read.
    """
    if recipe is not None and recipes is None:
        return RecipeBook.of_one(recipe)
    if recipes is not None and recipe is None:
        return RecipeBook.of_folder(recipes)
    raise UsageError("Name one recipe with --recipe R.toml, or a folder of them with --recipes DIR; one of the two.")
