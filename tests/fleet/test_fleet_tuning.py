"""A lake of two classes tuned: each gets a recipe that describes its sensors, and the odd ones are named."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.signal import lfilter

from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.arrays import Floats
from becalm.errors import InputError, UsageError
from becalm.fleet.batch import Fleet, clean
from becalm.fleet.recipes import open_book
from becalm.fleet.tuning.lake import LakeTuningOptions, TunedLake, tune_by
from made import RATE_HZ, Run, table_of, without_spark, write_parts

PUMP, VALVE = "kind=pump", "kind=valve"
NOISE = {PUMP: 1.0, VALVE: 0.05}
BANDWIDTH_HZ = {PUMP: 1.0, VALVE: 0.3}
NOISY = {f"{PUMP}/sensor=5", f"{VALVE}/sensor=11"}
CONSTANT, DAMAGED = f"{PUMP}/sensor=7", f"{VALVE}/sensor=3"
ODD = {*NOISY, CONSTANT, DAMAGED}
SPARK: Any = None


def moving(seed: int, bandwidth_hz: float, rows: int = 2500) -> Floats:
    """Return what moves within a bandwidth, about 5 m far."""
    keep = np.exp(-2 * np.pi * bandwidth_hz / RATE_HZ)
    walk = lfilter([1], [1, -keep], np.random.default_rng(seed).normal(size=rows + 500) * 5 * np.sqrt(1 - keep**2))
    return np.asarray(lfilter([1 - keep], [1, -keep], walk)[500:])


def noisy(seed: int, noise_std: float, bandwidth_hz: float = 1.0, rows: int = 2500) -> Floats:
    return moving(seed, bandwidth_hz, rows) + noise_std * np.random.default_rng(seed + 999).normal(size=rows)


def write_sensor(root: Path, name: str, **channels: Floats) -> None:
    times_s = np.arange(len(next(iter(channels.values())))) / RATE_HZ
    write_parts(root / name, table_of(times_s, **channels), (700,))


def write_fleet(root: Path) -> Path:
    """Write twenty sensors of either class: one of each three times as noisy, one constant, one damaged."""
    for place, kind in enumerate(NOISE):
        for number in range(20):
            name = f"{kind}/sensor={number}"
            noise_std = NOISE[kind] * (3.0 if name in NOISY else 1.0)
            readings = noisy(100 * place + number, noise_std, BANDWIDTH_HZ[kind])
            write_sensor(root, name, v=np.full(2500, 1.5) if name == CONSTANT else readings)
    for path in (root / DAMAGED).rglob("*.parquet"):
        path.write_bytes(b"PAR1 and then rubbish")
    return root


def here(work: Callable[[Any], Any], tasks: Sequence[Any]) -> list[Any]:
    """Run tasks as Spark would, one after the other."""
    return [work(task) for task in tasks]


def tuned_in(lake: Path, asked: LakeTuningOptions = LakeTuningOptions()) -> TunedLake:  # noqa: B008  (it cannot change)
    return tune_by(here, lake, lake.parent / "recipes", asked)


def cleaned_by(recipes: Path, lake: Path) -> Fleet:
    return clean(SPARK, lake, lake.parent / "out", open_book(None, recipes))


class Done(NamedTuple):
    lake: Path
    recipes: Path
    tuned: TunedLake


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Done:
    lake = write_fleet(tmp_path_factory.mktemp("fleet") / "lake")
    return Done(lake, lake.parent / "recipes", tuned_in(lake))


@pytest.mark.slow
def test_those_that_are_noisier_than_their_class_are_outlying_and_nobody_else(done: Done) -> None:
    told = {row.sensor: row.outlying for row in done.tuned.rows if row.outlying}
    assert set(told) == NOISY
    factors = [float(says.split("Its noise is ")[1].split(" times")[0]) for says in told.values()]
    assert factors == pytest.approx([3.0, 3.0], rel=0.1)
    verdicts = {row.sensor: row.verdict for row in done.tuned.rows}
    assert verdicts[CONSTANT] == "constant"
    assert {verdict for sensor, verdict in verdicts.items() if sensor not in ODD} == {"fits"}
    (failed,) = (row for row in done.tuned.rows if row.state == "refused")
    assert failed.sensor == DAMAGED
    assert "is cut short" in failed.reason


@pytest.mark.slow
def test_each_class_has_the_recipe_of_one_of_its_sensors(done: Done) -> None:
    assert done.tuned.recipes == (PUMP, VALVE)
    for klass in done.tuned.classes:
        path = done.recipes / f"{klass.name}.toml"
        recipe = Recipe.load(path)
        assert klass.class_recipe is not None
        (sensor,) = klass.class_recipe.sensors.values()
        own = next(one.recipe for one in klass.found if one.sensor == sensor)
        limits = recipe.channel[0].limits
        assert recipe.channel == (own.channel[0].model_copy(update={"limits": limits}),)
        assert recipe.tuned_on == own.tuned_on
        assert f"v of {sensor}" in path.read_text().splitlines()[0]
        assert recipe.channel[0].noise_std == pytest.approx(NOISE[klass.name], rel=0.1)
        assert klass.says == (
            f"{PUMP}: 20 of 20 sensors tuned. Its recipe describes 18 of 19 channels."
            if klass.name == PUMP
            else f"{VALVE}: 19 of 20 sensors tuned. Its recipe describes 18 of 19 channels."
        )


@pytest.mark.slow
def test_recipes_describe_all_but_the_odd_ones_when_the_lake_is_cleaned(
    done: Done, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_spark(monkeypatch)
    rows = cleaned_by(done.recipes, done.lake).rows
    assert {row.sensor for row in rows if row.verdict != "fits"} == ODD
    assert {row.sensor for row in rows if row.outlying} == NOISY
    assert {row.sensor for row in rows if row.faults} <= ODD
    lines = (done.lake.parent / "out" / "_becalm" / "outcomes.jsonl").read_text().splitlines()
    told = {one["sensor"]: one["channels"][0]["outlying"] for one in map(json.loads, lines)}
    assert all(told[sensor].startswith("Its innovations are 2.") for sensor in NOISY), told


@pytest.mark.slow
def test_what_was_found_is_told_beside_the_recipes(done: Done) -> None:
    told = [json.loads(line) for line in (done.recipes / "sensors.jsonl").read_text().splitlines()]
    by_sensor = {one["sensor"]: one for one in told}
    assert len(told) == len(by_sensor) == 40
    assert by_sensor[DAMAGED] == {"sensor": DAMAGED, "class": VALVE, "reason": told[0]["reason"], "channels": []}
    (channel,) = by_sensor[f"{PUMP}/sensor=5"]["channels"]
    assert channel["noise_std"] == pytest.approx(3.0, rel=0.1)
    assert (channel["verdict"], channel["class_verdict"]) == ("fits", "does not fit")
    assert channel["nis_mean"] == pytest.approx(1.0, abs=0.1)
    assert channel["class_nis_mean"] > 4
    page = (done.recipes / "report.html").read_text(encoding="utf-8")
    assert "kind=pump" in page
    assert "sensors are tuned" in page
    page_rows = {(row.sensor, row.noise_std) for row in done.tuned.rows if row.sensor == f"{PUMP}/sensor=5"}
    assert page_rows == {(f"{PUMP}/sensor=5", channel["noise_std"])}


def small_lake(tmp_path: Path, noises: Sequence[float] = (1.0, 1.0, 1.0, 6.0)) -> Path:
    for number, noise_std in enumerate(noises):
        write_sensor(tmp_path / "lake", f"sensor={number}", v=noisy(number, noise_std, rows=1500))
    return tmp_path / "lake"


def test_a_recipe_made_of_one_sensor_on_a_laptop_runs_over_the_lake(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    lake, recipe = small_lake(tmp_path, (1.0, 1.0)), tmp_path / "laptop.toml"
    assert run("tune", lake / "sensor=0", "-o", recipe).returncode == 0
    without_spark(monkeypatch)
    rows = clean(SPARK, lake, tmp_path / "out", open_book(recipe)).rows
    assert [(row.sensor, row.state, row.verdict) for row in rows] == [
        (f"sensor={number}", "cleaned", "fits") for number in range(2)
    ]
    (klass,) = tuned_in(lake).classes
    assert klass.found[0].recipe == Recipe.load(recipe)


def test_a_sensor_that_is_unlike_its_class_may_have_its_own_recipe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lake = small_lake(tmp_path)
    tuned = tuned_in(lake, LakeTuningOptions(own=True, causal=True))
    assert tuned.recipes == ("default", "sensor=3")
    row = next(row for row in tuned.rows if row.sensor == "sensor=3")
    assert (row.verdict, "does not describe it (NIS" in row.outlying) == ("fits", True)
    assert Recipe.load(tmp_path / "recipes" / "sensor=3.toml").mode == "causal"
    without_spark(monkeypatch)
    cleaned = cleaned_by(tmp_path / "recipes", lake).rows
    assert [one.verdict for one in cleaned] == ["fits"] * 4
    assert [one.recipe for one in cleaned] == [one.recipe for one in tuned.rows]


def test_recipes_that_are_there_are_replaced_only_where_that_is_asked(tmp_path: Path) -> None:
    lake, recipes = small_lake(tmp_path), tmp_path / "recipes"
    tuned_in(lake, LakeTuningOptions(own=True))
    (recipes / "notes.txt").write_text("mine")
    before = {path.name: path.read_bytes() for path in recipes.iterdir()}
    with pytest.raises(UsageError, match=r"holds recipes already, such as default\.toml.*--replace"):
        tuned_in(lake)
    assert {path.name: path.read_bytes() for path in recipes.iterdir()} == before
    tuned_in(lake, LakeTuningOptions(replace=True))
    assert {path.name for path in recipes.iterdir()} == set(before) - {"sensor=3.toml"}


def test_only_so_many_sensors_of_a_class_are_tuned(tmp_path: Path) -> None:
    tuned = tuned_in(small_lake(tmp_path, (1.0, 1.0, 6.0, 1.0, 1.0)), LakeTuningOptions(most_sensors=2))
    assert [row.sensor for row in tuned.rows] == ["sensor=0", "sensor=4"]
    says = tuned.classes[0].says
    assert says.startswith("default: 2 of 2 sensors tuned, spread evenly by name over all 5.")


def test_a_sensor_with_another_channel_is_named(tmp_path: Path) -> None:
    lake = small_lake(tmp_path, (1.0, 1.0, 1.0))
    write_sensor(lake, "sensor=3", v=noisy(3, 1.0, rows=1500), w=noisy(4, 1.0, rows=1500))
    write_sensor(lake, "sensor=4", u=noisy(5, 1.0, rows=1500))
    tuned = tuned_in(lake)
    told = {(row.sensor, row.channel): row.outlying for row in tuned.rows if row.outlying}
    assert set(told) == {("sensor=3", "w"), ("sensor=4", "u")}
    assert told["sensor=4", "u"].startswith("Its class's recipe does not run on it: ")
    assert "'v'" in told["sensor=4", "u"]


def test_a_sensor_in_another_unit_is_converted_and_like_its_class(tmp_path: Path) -> None:
    lake = small_lake(tmp_path, (1.0, 1.0, 1.0))
    table = table_of(np.arange(1500) / RATE_HZ, v=1e3 * noisy(3, 1.0, rows=1500))
    fields = [field.with_metadata({b"unit": b"mm"}) if field.name == "v" else field for field in table.schema]
    write_parts(lake / "sensor=3", table.cast(pa.schema(fields)))
    rows = {row.sensor: row for row in tuned_in(lake).rows}
    assert {(row.unit, row.verdict, row.outlying) for row in rows.values()} == {("m", "fits", "")}
    assert rows["sensor=3"].noise_std == pytest.approx(1.0, rel=0.1)


def test_classes_that_are_none_are_said_to_be(tmp_path: Path) -> None:
    lake = small_lake(tmp_path, (1.0, 30.0, 0.05, 5.0))
    (klass,) = tuned_in(lake).classes
    assert "They are of several kinds" in klass.says


def test_files_may_be_sensors(tmp_path: Path) -> None:
    for number in range(2):
        (tmp_path / "lake" / "pumps").mkdir(parents=True, exist_ok=True)
        table = pa.table({"time_s": np.arange(1500) / RATE_HZ, "v": noisy(number, 1.0, rows=1500)})
        pq.write_table(table, tmp_path / "lake" / "pumps" / f"{number}.parquet")
    tuned = tuned_in(tmp_path / "lake", LakeTuningOptions(by="file"))
    assert tuned.recipes == ("pumps",)
    assert [row.sensor for row in tuned.rows] == ["pumps/0.parquet", "pumps/1.parquet"]


def test_what_cannot_be_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    lake = small_lake(tmp_path, (1.0,))
    with pytest.raises(UsageError, match="--sensors 0 tunes none"):
        tuned_in(lake, LakeTuningOptions(most_sensors=0))
    with pytest.raises(UsageError, match="--by unit identifies sensors by a column"):
        tuned_in(lake, LakeTuningOptions(by="unit"))
    with pytest.raises(UsageError, match="overlaps the lake"):
        tune_by(here, lake, lake / "recipes")
    with pytest.raises(InputError, match="is not a folder"):
        tuned_in(tmp_path / "nowhere")


def test_the_command_says_what_is_wrong_before_spark_starts(tmp_path: Path, run: Run) -> None:
    small_lake(tmp_path, (1.0,))
    ran = run("fleet", "tune", "lake", "-o", "recipes", "--sensors", "0", "--master", "spark://nowhere:7077")
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr.strip() == "becalm: --sensors 0 tunes none; give a number above 0, or omit the option."
    assert not (tmp_path / "recipes").exists()


def test_a_lake_of_which_nothing_can_be_tuned_says_why(tmp_path: Path) -> None:
    lake = small_lake(tmp_path, (1.0,))
    for path in lake.rglob("*.parquet"):
        path.write_bytes(b"PAR1 and then rubbish")
    with pytest.raises(InputError, match=r"No sensor of .* could be tuned; the first, sensor=0: .* is cut short"):
        tuned_in(lake)
    assert [path.name for path in (tmp_path / "recipes").iterdir()] == [".lock"]


def test_names_of_all_kinds_leave_recipes_that_can_be_read(tmp_path: Path) -> None:
    write_sensor(tmp_path / "lake", 'kind="ü\nx"/sensor=1', v=noisy(1, 1.0, rows=1500))
    assert tuned_in(tmp_path / "lake").recipes == ('kind="ü\nx"',)
    (path,) = (tmp_path / "recipes").glob("*.toml")
    assert tomllib.loads(path.read_text(encoding="utf-8"))["mode"] == "smoothed"


@pytest.mark.slow
@pytest.mark.spark
def test_on_spark_it_is_the_same(done: Done, run_here: Run, tmp_path: Path) -> None:
    pytest.importorskip("pyspark", reason="it runs on Spark: pip install pyspark")
    ran = run_here("fleet", "tune", done.lake, "-o", "recipes", "--master", "local[2]", "--json")
    assert ran.returncode == 4, ran.stderr  # one sensor is refused
    for name in (f"{PUMP}.toml", f"{VALVE}.toml", "sensors.jsonl"):
        assert (tmp_path / "recipes" / name).read_text() == (done.recipes / name).read_text()
    told = json.loads(ran.stdout)
    assert told["recipes"] == [PUMP, VALVE]
    assert len(told["sensors"]) == 40
    assert f"{DAMAGED}: " in ran.stderr
    assert f"{PUMP}/sensor=5, v: Its noise is 3" in ran.stderr
    assert "--recipes recipes" in ran.stderr
    again = run_here("fleet", "tune", done.lake, "-o", "recipes", "--master", "local[2]")
    assert again.returncode == 2
    assert "--replace" in again.stderr
