"""Small lakes, and a stand-in for Spark that runs tasks one after the other."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from becalm.cleaning.recipes.recipe import ChannelRecipe, Mode, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import LimitsRecipe
from becalm.core.arrays import Floats
from becalm.fleet.job import Job, Sensor
from becalm.fleet.lake import places_in
from becalm.fleet.recipes import RecipeBook

RATE_HZ = 100.0

Run = Callable[..., subprocess.CompletedProcess[str]]


def recipe_of(*names: str, mode: Mode = "causal", density: float = 4.0) -> Recipe:
    """Return a recipe for some channels."""
    watch: dict[str, Any] = {"stuck_readings": 30, "drift_threshold": 40.0, "dead_variance": 0.05}
    watch |= {"outlier_distance": 9.0, "causal_outlier_distance": 12.0}
    limits = LimitsRecipe(low=-500.0, high=500.0, **watch)
    told: dict[str, Any] = {"unit": "m", "model": "motion", "order": 1, "noise_std": 1.0, "limits": limits}
    channels = tuple(ChannelRecipe(name=name, process_noise_density=density, **told) for name in names)
    return Recipe(mode=mode, tuned_on=Origin(rate_hz=RATE_HZ), channel=channels)


def walk(seed: int, rows: int, holes: int = 0) -> Floats:
    """Return a noisy walk, in which so many stretches are missing."""
    rng = np.random.default_rng(seed)
    z = 0.2 * np.cumsum(rng.normal(size=rows)) + rng.normal(size=rows)
    for begin in rng.integers(1000, max(1001, rows - 1000), holes):
        z[begin : begin + rng.integers(1, 300)] = np.nan
    return z


def table_of(times_s: Floats, **channels: Floats) -> pa.Table:
    """Return a table of a time in seconds, channels in metres, and a column of text."""
    fields = [pa.field("time_s", pa.float64())]
    fields += [pa.field(name, pa.float64(), metadata={b"unit": b"m"}) for name in channels]
    columns = [pa.array(times_s), *(pa.array(values) for values in channels.values())]
    table = pa.table(columns, schema=pa.schema(fields))
    return table.append_column("note", pa.array([f"row {row % 7}" for row in range(len(times_s))]))


def write_parts(folder: Path, table: pa.Table, cuts: Sequence[int] = (), **how: Any) -> None:
    """Write a table into files, a folder for each day, whose names are not in the order of time."""
    bounds = [0, *cuts, table.num_rows]
    for day, (first, stop) in enumerate(pairwise(bounds)):
        place = folder / f"date=2026-01-{day + 1:02d}"
        place.mkdir(parents=True)
        pq.write_table(table.slice(first, stop - first), place / f"part-{9 - day}.parquet", **how)


def read_parts(folder: Path) -> pa.Table:
    """Return the rows of an output, in the order of time, however it is cut into files."""
    tables = [pq.read_table(path, partitioning=None) for path in folder.rglob("*.parquet")]
    return pa.concat_tables(tables).sort_by("time_s")


def same(one: pa.Table, other: pa.Table) -> bool:
    """Tell whether two tables have the same columns and, to the bit, the same rows."""
    assert one.column_names == other.column_names
    return all(_equal(one.column(name), other.column(name)) for name in one.column_names)


def farthest(one: pa.Table, other: pa.Table, name: str) -> float:
    """Return how far apart two columns are, beside the largest number in them."""
    a, b = one.column(name).to_numpy(), other.column(name).to_numpy()
    assert np.array_equal(np.isnan(a), np.isnan(b))
    return float(np.nanmax(np.abs(a - b)) / np.nanmax(np.abs(b)))


def _equal(one: pa.ChunkedArray, other: pa.ChunkedArray) -> bool:
    if pa.types.is_floating(one.type):
        return bool(np.array_equal(one.to_numpy(), other.to_numpy(), equal_nan=True))
    return bool(one.cast(pa.string()).equals(other.cast(pa.string())))


class Lake(NamedTuple):
    """A lake, and a recipe for it."""

    root: Path
    recipe: Path


def one_after_the_other(
    spark: object, work: Callable[[Any], Any], tasks: Sequence[Any], *_: object, **__: object
) -> list[Any]:
    """Run tasks as Spark would, here and now."""
    return [work(task) for task in tasks]


def without_spark(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let jobs run without Spark."""
    for module in ("becalm.fleet.batch", "becalm.fleet.grouped.cleaning", "becalm.fleet.stretching.cleaning"):
        monkeypatch.setattr(f"{module}.run_tasks", one_after_the_other)


def job_of(lake: Path, output: Path, book: RecipeBook) -> tuple[Job, list[Sensor]]:
    """Return a job, and the sensors of its lake."""
    sensors = [Sensor(place.name, place.bytes, str(book.hash_for(place.name))) for place in places_in(lake)]
    return Job(str(lake), str(output), book.by_hash), sensors
