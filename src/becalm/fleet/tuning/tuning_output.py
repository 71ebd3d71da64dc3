"""Write the results of tuning a lake: recipes of classes and of single sensors, all results as JSON, and a report."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from becalm.cleaning.recipes.recipe import Recipe
from becalm.errors import RecipeError, UsageError
from becalm.files.atomic_file import explain_write_errors, write_folder
from becalm.fleet.outcome import SHOWN
from becalm.fleet.recipes import ENDING, RecipeBook, recipes_in
from becalm.fleet.tuning.classes import TunedClass
from becalm.fleet.tuning.sensor_tuning import TunedChannel
from becalm.report.fleet.fleet_page import FleetFacts, fleet_page
from becalm.report.fleet.fleet_rows import FleetRow

REPORT, SENSORS = "report.html", "sensors.jsonl"
"""File names of the report page, and of the results of each sensor."""


def refuse_recipes(folder: Path) -> None:
    """Raise an error if a folder holds recipes.

    Raises
    ------
    UsageError
        If the folder holds a recipe.
    """
    if present := recipes_in(folder):
        raise UsageError(
            f"{folder} holds recipes already, such as {present[0].relative_to(folder)}; name another folder with -o, or"
            " repeat with --replace, which replaces all of them."
        )


class NamedRecipe(NamedTuple):
    """A recipe to write, and a sentence on the sensors that it was made from."""

    recipe: Recipe
    origin: str


def named_recipes(classes: Sequence[TunedClass], *, own: bool) -> dict[str, NamedRecipe]:
    """Return the recipes of classes, and with `own` of single sensors, by the names under which jobs search for them.

    Parameters
    ----------
    classes : sequence of TunedClass
        The tuned classes. With `own`, they need `judged`: the outcomes of each class's recipe.
    own : bool
        Whether to include the own recipe of each sensor that differs from its class.
    """
    sensors = {
        one.sensor: NamedRecipe(one.recipe, f"Recipe of {one.sensor}, which differs from its class.")
        for klass in classes
        for one in klass.found
        if own and any((one.sensor, channel.recipe.name) in klass.differences for channel in one.channels)
    }
    of_classes = {
        klass.name: NamedRecipe(klass.class_recipe.recipe, _origin(klass))
        for klass in classes
        if klass.class_recipe is not None
    }
    return sensors | of_classes  # if a sensor and a class have the same name, the class's recipe counts


def book_of(named: Mapping[str, NamedRecipe]) -> RecipeBook:
    """Return the recipes as a book, in which a job finds the recipe of a sensor."""
    return RecipeBook({name: one.recipe.to_toml() for name, one in named.items()}, "What was tuned")


def _origin(klass: TunedClass) -> str:
    """Return a sentence on the sensors that the recipe of a class was made from."""
    assert klass.class_recipe is not None, "the class has no recipe"
    sources = ", ".join(f"{channel} of {sensor}" for channel, sensor in klass.class_recipe.sensors.items())
    return f"Recipe of the class {klass.name}, from {len(klass.found)} tuned sensors; the most typical: {sources}."


def write_found(
    folder: Path, classes: Sequence[TunedClass], named: Mapping[str, NamedRecipe], facts: FleetFacts
) -> list[FleetRow]:
    """Write recipes, the results of each sensor, and the page; return the rows of the page.

    If there are new recipes, all older recipes in the folder are removed; other files are not.

    Raises
    ------
    OutputError
        If a file cannot be written or removed.
    """
    book = book_of(named)
    rows = [row for klass in classes for row in _rows(klass, named, book)]
    texts = {name + ENDING: _commented(one.origin) + one.recipe.to_toml() for name, one in named.items()}
    lines = [json.dumps(values) + "\n" for values in values_of(classes)]
    older = [path for path in recipes_in(folder) if named and _is_recipe(path)]
    write_folder(folder, {**texts, SENSORS: "".join(lines), REPORT: fleet_page(rows, facts)})
    for path in set(older) - {folder / name for name in texts}:
        with explain_write_errors(path):
            path.unlink(missing_ok=True)
    return rows


def _is_recipe(path: Path) -> bool:
    try:
        Recipe.load(path)
    except RecipeError:
        return False
    return True


def _commented(text: str) -> str:
    """Return text as a TOML comment, without control characters."""
    return f"# {''.join(one if one.isprintable() else ' ' for one in text)}\n"


def _rows(klass: TunedClass, named: Mapping[str, NamedRecipe], book: RecipeBook) -> list[FleetRow]:
    """Return the report's rows of a class: the results of the written recipes on the rows that were used for tuning."""
    rows = [row for outcome in klass.failed for row in outcome.channels]
    for one in klass.found:
        alone = one.sensor in named and named[one.sensor].recipe is one.recipe
        shown = (book.hash_for(one.sensor) or "")[:SHOWN]
        for channel in one.channels:
            reason = klass.differences.get((one.sensor, channel.recipe.name), "")
            rows.append(replace(klass.row_of(channel, own=alone), recipe=shown, outlying=reason))
    return rows


def values_of(classes: Sequence[TunedClass]) -> list[dict[str, Any]]:
    """Return the results of all sensors as plain values; sensors that could not be tuned come first."""
    failed = [_of_sensor(klass, one.sensor, one.reason) for klass in classes for one in klass.failed]
    return failed + [_of_sensor(klass, one.sensor, "", one.channels) for klass in classes for one in klass.found]


def _of_sensor(klass: TunedClass, sensor: str, reason: str, channels: Sequence[TunedChannel] = ()) -> dict[str, Any]:
    values = [_values(klass, channel) for channel in channels]
    return {"sensor": sensor, "class": klass.name, "reason": reason, "channels": values}


def _values(klass: TunedClass, channel: TunedChannel) -> dict[str, Any]:
    """Return the results of a channel: with its own recipe, and with the recipe of its class."""
    own, row, by_class = channel.recipe, channel.row, klass.row_of(channel, own=False)
    return {
        "name": own.name,
        "unit": own.unit,
        "model": own.model,
        "order": own.order,
        "noise_std": own.noise_std,
        "process_noise_density": own.process_noise_density,
        "verdict": row.verdict,
        "nis_mean": row.health,
        "class_verdict": by_class.verdict,
        "class_nis_mean": by_class.health,
        "outlying": klass.differences.get((channel.sensor, own.name), ""),
    }
