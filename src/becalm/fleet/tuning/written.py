"""What tuning a lake leaves: a recipe for each class, perhaps some for sensors, what was found, and a page."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from becalm.cleaning.recipe import Recipe
from becalm.errors import RecipeError, UsageError
from becalm.files.atomic_file import sentences
from becalm.files.text_file import write_folder
from becalm.fleet.outcome import SHOWN
from becalm.fleet.recipes import ENDING, RecipeBook, recipes_in
from becalm.fleet.tuning.classes import TunedClass
from becalm.fleet.tuning.found import TunedChannel
from becalm.report.fleet_page import FleetFacts, fleet_page
from becalm.report.fleet_rows import FleetRow

REPORT, SENSORS = "report.html", "sensors.jsonl"
"""Names of the page, and of what was found for each sensor, beside the recipes."""


def refuse_recipes(folder: Path) -> None:
    """Refuse a folder that holds recipes.

    Raises
    ------
    UsageError
        If it does.
    """
    if held := recipes_in(folder):
        raise UsageError(
            f"{folder} holds recipes already, as {held[0].relative_to(folder)}; name another folder with -o, or repeat"
            " with --replace, which puts new ones in the place of all of them."
        )


class NamedRecipe(NamedTuple):
    """A recipe to be written, and of whom it is, in a sentence."""

    recipe: Recipe
    origin: str


def named_recipes(classes: Sequence[TunedClass], *, own: bool) -> dict[str, NamedRecipe]:
    """Return recipes by the names that jobs look them up by: those of classes, and perhaps of sensors.

    Parameters
    ----------
    classes : sequence of TunedClass
        Tuned; where sensors are to have their own, judged as well.
    own : bool
        Whether sensors that are unlike their class have recipes of their own.
    """
    sensors = {
        one.sensor: NamedRecipe(one.recipe, f"Of {one.sensor}, which is unlike its class.")
        for klass in classes
        for one in klass.found
        if own and any((one.sensor, channel.recipe.name) in klass.unlike for channel in one.channels)
    }
    told = {
        klass.name: NamedRecipe(klass.typical.recipe, _origin(klass)) for klass in classes if klass.typical is not None
    }
    return sensors | told  # a sensor may be called as its class is


def book_of(named: Mapping[str, NamedRecipe]) -> RecipeBook:
    """Return recipes as jobs look them up."""
    return RecipeBook({name: one.recipe.to_toml() for name, one in named.items()}, "What was tuned")


def _origin(klass: TunedClass) -> str:
    """Say whose recipe that of a class is."""
    assert klass.typical is not None, "a class without a recipe has none to tell of"
    told = ", ".join(f"{channel} of {sensor}" for channel, sensor in klass.typical.sensors.items())
    return f"Of the class {klass.name}, {len(klass.found)} sensors of which were tuned; the most typical: {told}."


def write_found(
    folder: Path, classes: Sequence[TunedClass], named: Mapping[str, NamedRecipe], facts: FleetFacts
) -> list[FleetRow]:
    """Write recipes, what was found, and the page; return the rows of the page.

    Where there are new recipes, all others of the folder go; files that are no recipes stay.

    Raises
    ------
    OutputError
        If that cannot be done.
    """
    book = book_of(named)
    rows = [row for klass in classes for row in _rows(klass, named, book)]
    texts = {name + ENDING: _commented(one.origin) + one.recipe.to_toml() for name, one in named.items()}
    lines = [json.dumps(told) + "\n" for told in values_of(classes)]
    older = [path for path in recipes_in(folder) if named and _is_recipe(path)]
    write_folder(folder, {**texts, SENSORS: "".join(lines), REPORT: fleet_page(rows, facts)})
    for path in set(older) - {folder / name for name in texts}:
        with sentences(path):
            path.unlink(missing_ok=True)
    return rows


def _is_recipe(path: Path) -> bool:
    try:
        Recipe.load(path)
    except RecipeError:
        return False
    return True


def _commented(text: str) -> str:
    """Return text as a comment of TOML, which holds no control characters."""
    return f"# {''.join(one if one.isprintable() else ' ' for one in text)}\n"


def _rows(klass: TunedClass, named: Mapping[str, NamedRecipe], book: RecipeBook) -> list[FleetRow]:
    """Return the rows of the sensors of a class: what cleaning by these recipes would make of what was looked at."""
    told = [row for outcome in klass.failed for row in outcome.channels]
    for one in klass.found:
        alone = one.sensor in named and named[one.sensor].recipe is one.recipe
        shown = (book.hash_for(one.sensor) or "")[:SHOWN]
        for channel in one.channels:
            reason = klass.unlike.get((one.sensor, channel.recipe.name), "")
            told.append(replace(klass.row_of(channel, own=alone), recipe=shown, outlying=reason))
    return told


def values_of(classes: Sequence[TunedClass]) -> list[dict[str, Any]]:
    """Return what was found for all sensors, as plain values: those first that could not be tuned."""
    failed = [_of_sensor(klass, one.sensor, one.reason) for klass in classes for one in klass.failed]
    return failed + [_of_sensor(klass, one.sensor, "", one.channels) for klass in classes for one in klass.found]


def _of_sensor(klass: TunedClass, sensor: str, reason: str, channels: Sequence[TunedChannel] = ()) -> dict[str, Any]:
    told = [_values(klass, channel) for channel in channels]
    return {"sensor": sensor, "class": klass.name, "reason": reason, "channels": told}


def _values(klass: TunedClass, channel: TunedChannel) -> dict[str, Any]:
    """Return what was found for a channel: by its own recipe, and by that of its class."""
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
        "outlying": klass.unlike.get((channel.sensor, own.name), ""),
    }
