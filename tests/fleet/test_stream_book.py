"""Which recipe of a folder a sensor of a stream has."""

from __future__ import annotations

from pathlib import Path

import pytest

from becalm.errors import RecipeError
from becalm.fleet.names import folder_name
from becalm.fleet.stream.live_book import LiveBook
from made import recipe_of


def recipes(folder: Path, *names: str) -> LiveBook:
    for number, name in enumerate(names):
        path = folder / f"{name}.toml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(recipe_of("a", density=1.0 + number).to_toml(), encoding="utf-8")
    return LiveBook(folder)


def density(book: LiveBook, sensor: str) -> float:
    return float(book.recipe_for(sensor).channel[0].process_noise_density or 0)


def test_a_sensor_has_its_own_recipe_or_that_of_all_others(tmp_path: Path) -> None:
    book = recipes(tmp_path, "default", "17", "sensor=18", folder_name("sensor", "a/b"), folder_name("sensor", "50 %"))
    assert [density(book, sensor) for sensor in ("16", "17", "18", "a/b", "50 %")] == [1, 2, 3, 4, 5]
    assert density(book, "x" * 300) == 1
    assert book.channels() == ("a",)


def test_a_sensor_without_one_is_told_what_to_add(tmp_path: Path) -> None:
    book = recipes(tmp_path, "17")
    with pytest.raises(RecipeError, match=r"no recipe for 'a/b'; add sensor=a%2Fb\.toml, or default\.toml"):
        book.recipe_for("a/b")


@pytest.mark.parametrize("name", ["plant=3", "plant=3/sensor=17", "deep/17"])
def test_recipes_that_no_sensor_would_find_are_refused(tmp_path: Path, name: str) -> None:
    book = recipes(tmp_path, "default", name)
    with pytest.raises(RecipeError, match="is not a recipe that a sensor in 'sensor' can have"):
        book.channels()
