"""Which sensors a lake holds, and which recipe each of them has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from becalm.errors import RecipeError, UsageError
from becalm.fleet.lake import FILE, FOLDER, find_sensor_layout, places_in
from becalm.fleet.recipes import open_book
from made import recipe_of, table_of


def write(lake: Path, *names: str) -> Path:
    """Write small files of these names."""
    for name in names:
        (lake / name).parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table_of(np.arange(4) / 100, a=np.ones(4)), lake / name)
    return lake


def names(lake: Path, by: str = FOLDER) -> list[str]:
    return [place.name for place in places_in(lake, by)]


@pytest.mark.parametrize(
    ("files", "sensors"),
    [
        (("sensor=1/a.parquet", "sensor=2/a.parquet"), ["sensor=1", "sensor=2"]),
        (("sensor=1/date=2026-01-01/a.parquet", "sensor=1/date=2026-01-02/a.parquet"), ["sensor=1"]),
        (("sensor=1/year=2026/month=1/a.pq",), ["sensor=1"]),
        (("plant=3/sensor=1/a.parquet", "plant=4/sensor=1/a.parquet"), ["plant=3/sensor=1", "plant=4/sensor=1"]),
        (("pumps/left/a.parquet", "pumps/left/b.parquet", "pumps/right/a.parquet"), ["pumps/left", "pumps/right"]),
        (("a.parquet", "b.parquet"), ["."]),
        (("date=2026-01-01/a.parquet", "date=2026-01-02/a.parquet"), ["."]),
        (("sensor=1/a.parquet", "sensor=2/_a.parquet", ".hidden/a.parquet", "_becalm/a.parquet"), ["sensor=1"]),
    ],
)
def test_a_folder_above_those_that_tell_times_is_a_sensor(
    files: tuple[str, ...], sensors: list[str], tmp_path: Path
) -> None:
    assert names(write(tmp_path / "lake", *files)) == sensors


def test_each_file_may_be_one(tmp_path: Path) -> None:
    assert names(write(tmp_path / "lake", "b.parquet", "deep/a.parquet"), FILE) == ["b.parquet", "deep/a.parquet"]


def test_sensors_below_times_are_refused_with_what_to_type(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"--by sensor"):
        names(write(tmp_path / "lake", "date=2026-01-01/sensor=1/a.parquet"))


def test_a_folder_is_called_as_it_is_and_not_as_a_link_to_it(tmp_path: Path) -> None:
    lake = write(tmp_path / "lake", "plant=3/sensor=9/a.parquet", "\uff13/a.parquet")
    (lake / "a").symlink_to(lake / "plant=3" / "sensor=9")
    assert names(lake) == ["plant=3/sensor=9", "\uff13"]


def test_keys_that_folders_tell_need_no_file_to_be_read(tmp_path: Path) -> None:
    lake = write(tmp_path / "lake", "date=2026-01-01/sensor=1/a.parquet", "date=2026-01-01/sensor=2/a.parquet")
    (lake / "date=2026-01-01" / "sensor=1" / "a.parquet").write_bytes(b"rubbish")
    told = find_sensor_layout(lake, "sensor")
    assert isinstance(told, list)
    assert [place.name for place in told] == ["sensor=1", "sensor=2"]
    with pytest.raises(UsageError, match="'sensor' twice"):
        find_sensor_layout(lake, "sensor,sensor")


def test_files_beside_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"--by file"):
        names(write(tmp_path / "lake", "a.parquet", "sensor=1/a.parquet"))


def test_the_nearest_recipe_is_taken(tmp_path: Path) -> None:
    folder, told = tmp_path / "recipes", {}
    for k, name in enumerate(("default", "plant=3", "plant=3/sensor=1", "plant=3/hall/sensor=2")):
        text = recipe_of("a", density=1.0 + k).to_toml()
        path = folder / f"{name}.toml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        told[name] = text
    book = open_book(recipes=folder)
    wanted = {
        "plant=3/sensor=1": "plant=3/sensor=1",
        "plant=3/sensor=2": "plant=3",
        "plant=3/hall/sensor=2": "plant=3/hall/sensor=2",
        "plant=3/hall/sensor=3": "plant=3",
        "plant=4/sensor=1": "default",
        ".": "default",
    }
    found = {sensor: book.hash_for(sensor) for sensor in wanted}
    assert {sensor: book.by_hash[str(one)] for sensor, one in found.items()} == {
        sensor: told[name] for sensor, name in wanted.items()
    }


def test_a_recipe_that_no_sensor_has_is_named(tmp_path: Path) -> None:
    for name in ("default", "sensor=O1", "plant=3/sensor=1", "plant=4"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.toml").write_text(recipe_of("a").to_toml(), encoding="utf-8")
    book = open_book(recipes=tmp_path)
    assert book.unused(["sensor=01", "plant=3/sensor=1", "plant=4/sensor=1"]) == ("sensor=O1",)


def test_a_sensor_without_a_recipe_is_told_what_to_add(tmp_path: Path) -> None:
    folder = tmp_path / "recipes"
    folder.mkdir()
    (folder / "sensor=1.toml").write_text(recipe_of("a").to_toml(), encoding="utf-8")
    book = open_book(recipes=folder)
    assert book.hash_for("sensor=2") is None
    assert "sensor=2.toml, or default.toml" in book.why_not("sensor=2")


def test_what_was_named_is_said_where_it_does_not_do(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="one of the two"):
        open_book()
    with pytest.raises(UsageError, match="one of the two"):
        open_book(tmp_path / "r.toml", tmp_path)
    with pytest.raises(RecipeError, match="holds no recipes"):
        open_book(recipes=tmp_path)
    (tmp_path / "default.toml").write_text("no recipe", encoding="utf-8")
    with pytest.raises(RecipeError, match=r"default\.toml"):
        open_book(recipes=tmp_path)
