"""Find the recipe of each sensor: one recipe for all, or a folder of recipes with the same layout as the lake."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from becalm.cleaning.recipes.recipe import Recipe
from becalm.errors import RecipeError, UsageError

DEFAULT = "default"
"""Name, without ending, of the recipe for all sensors that have no other recipe."""

ENDING = ".toml"
"""Ending of recipe files."""


class RecipeBook:
    """A collection of recipes, which finds the recipe of a sensor by its name.

    Parameters
    ----------
    texts : mapping of str to str
        TOML texts of recipes by name. A name is the path of a sensor, or of a folder of sensors, within the lake, or
        `DEFAULT` for all other sensors.
    source : str
        The file or folder that the recipes were read from, for messages.

    Attributes
    ----------
    by_hash : dict of str to str
        The texts by their SHA-256 hashes in hexadecimal digits.
    names : tuple of str
        The names of all recipes, sorted.
    """

    def __init__(self, texts: dict[str, str], source: str) -> None:
        self._source, self.names = source, tuple(sorted(texts))
        self._hashes = {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()}
        self.by_hash = {self._hashes[name]: text for name, text in texts.items()}

    @classmethod
    def of_one(cls, path: Path) -> RecipeBook:
        """Read one recipe for all sensors.

        Raises
        ------
        RecipeError
            If the file cannot be read, or is not a recipe.
        """
        return cls({DEFAULT: Recipe.load(path).to_toml()}, str(path))

    @classmethod
    def of_folder(cls, folder: Path) -> RecipeBook:
        """Read a folder of recipes: `plant=3/sensor=17.toml`, `plant=3.toml`, `default.toml`.

        Raises
        ------
        RecipeError
            If the folder holds no recipe, or a recipe cannot be read.
        """
        if not folder.is_dir():
            raise RecipeError(f"{folder} is not a folder; name one that holds recipes, or one recipe with --recipe.")
        paths = recipes_in(folder)
        if not paths:
            raise RecipeError(
                f"{folder} holds no recipes. Name a file {DEFAULT}{ENDING}, or after its sensor, such as"
                f" sensor=17{ENDING}; or make recipes with: becalm fleet tune LAKE -o {folder}"
            )
        names = (path.relative_to(folder).as_posix().removesuffix(ENDING) for path in paths)
        return cls({name: Recipe.load(path).to_toml() for name, path in zip(names, paths, strict=True)}, str(folder))

    def name_for(self, sensor: str) -> str:
        """Return the name of a sensor's recipe: its own, else that of the nearest folder above it, else `DEFAULT`."""
        path = PurePosixPath(sensor)
        names = map(str, (path, sensor.removesuffix(".parquet").removesuffix(".pq"), *path.parents))
        return next((name for name in names if name in self._hashes), DEFAULT)

    def hash_for(self, sensor: str) -> str | None:
        """Return the hash of a sensor's recipe, or None if it has none."""
        return self._hashes.get(self.name_for(sensor))

    def unused(self, sensors: Iterable[str]) -> tuple[str, ...]:
        """Return the names of recipes, except `DEFAULT`, that no sensor in `sensors` uses."""
        return tuple(sorted({*self.names} - {DEFAULT} - set(map(self.name_for, sensors))))

    def why_not(self, sensor: str) -> str:
        """Return a sentence which says that a sensor has no recipe, and how to add one."""
        own = "" if sensor == "." else f"{sensor}{ENDING}, or "  # a lake that is one sensor has no folder name
        return f"{self._source} has no recipe for it; add {own}{DEFAULT}{ENDING} for all others."


def recipes_in(folder: Path) -> list[Path]:
    """List the recipes in a folder and its subfolders, without hidden files and hidden folders."""
    paths = sorted(folder.rglob(f"*{ENDING}"))
    return [path for path in paths if not any(part.startswith(".") for part in path.relative_to(folder).parts)]


def open_book(recipe: Path | None = None, recipes: Path | None = None) -> RecipeBook:
    """Read one recipe, or a folder of recipes.

    Raises
    ------
    UsageError
        If neither or both are given.
    RecipeError
        If a recipe cannot be read.
    """
    if recipe is not None and recipes is None:
        return RecipeBook.of_one(recipe)
    if recipes is not None and recipe is None:
        return RecipeBook.of_folder(recipes)
    raise UsageError("Name one recipe with --recipe R.toml, or a folder of them with --recipes DIR; one of the two.")
