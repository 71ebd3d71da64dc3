"""Lakes whose folders put times above their sensors: read where they are, with nothing moved."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from becalm.errors import UsageError
from becalm.fleet.batch import BatchOptions
from becalm.fleet.grouped import cleaning
from made import Lake, Run, read_parts, recipe_of, same, without_spark
from shared_lakes import KEY, as_a_file, cleaned, own_table, read_again, states, write_files

ROWS = 3000


@pytest.fixture(autouse=True)
def _no_spark(monkeypatch: pytest.MonkeyPatch) -> None:
    without_spark(monkeypatch)


def by_date(place: Path, tables: dict[str, pa.Table]) -> Lake:
    """Write sensors as folders below those of dates."""
    for name, table in tables.items():
        for day in range(3):
            own = table.slice(day * table.num_rows // 3, table.num_rows // 3)
            write_files(place / "lake" / f"date=2026-01-{day + 1:02d}" / f"sensor={name}", own, 1)
    recipe = place / "r.toml"
    recipe.write_text(recipe_of("a", "b").to_toml(), encoding="utf-8")
    return Lake(place / "lake", recipe)


def test_sensors_below_times_are_read_where_they_are(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    tables = {"1": own_table(1, ROWS), "a%2Fb": own_table(2, ROWS)}
    lake = by_date(tmp_path, tables)
    with pytest.raises(UsageError, match=r"--by sensor$"):
        cleaned(lake, BatchOptions())
    monkeypatch.setattr(cleaning, "split_rows", read_again)
    assert states(cleaned(lake)) == {"sensor=1": "cleaned", "sensor=a%2Fb": "cleaned"}
    for name, table in tables.items():
        out = tmp_path / "out" / f"sensor={name}"
        days = [f"date=2026-01-{day:02d}/part-0.parquet" for day in (1, 2, 3)]
        assert sorted(path.relative_to(out).as_posix() for path in out.rglob("*.parquet")) == days
        assert same(read_parts(out), as_a_file(run, lake, table))
    assert {*states(cleaned(lake)).values()} == {"kept"}
    (lake.root / "date=2026-01-03" / "sensor=1" / "part-0.parquet").unlink()
    assert states(cleaned(lake)) == {"sensor=1": "cleaned", "sensor=a%2Fb": "kept"}
    assert read_parts(tmp_path / "out" / "sensor=1").num_rows == 2 * ROWS // 3


def test_a_long_sensor_below_times_is_cut_in_time(tmp_path: Path, run: Run) -> None:
    table = own_table(1, 10 * ROWS)
    lake = by_date(tmp_path, {"1": table})
    (one,) = cleaned(lake, BatchOptions(by=KEY, stretch_rows=8192)).outcomes
    assert one.seams
    assert same(read_parts(tmp_path / "out" / "sensor=1"), as_a_file(run, lake, table))


def test_folders_below_times_may_need_several_keys(tmp_path: Path) -> None:
    for plant in (1, 2):
        write_files(tmp_path / "lake" / "date=1" / f"plant={plant}" / "sensor=3", own_table(plant, 300), 1)
    recipe = tmp_path / "r.toml"
    recipe.write_text(recipe_of("a").to_toml(), encoding="utf-8")
    lake = Lake(tmp_path / "lake", recipe)
    with pytest.raises(UsageError, match=r"--by plant,sensor$"):
        cleaned(lake, BatchOptions())
    assert list(states(cleaned(lake, BatchOptions(by="plant,sensor")))) == ["plant=1/sensor=3", "plant=2/sensor=3"]
