"""Run the stream of a fleet on Spark until it ends, fails or is stopped."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from becalm.cli.commands.fleet import spark_at
from becalm.errors import UsageError
from becalm.files.atomic_file import make_folder
from becalm.fleet.output_lock import lock_output
from becalm.fleet.stream import LiveBook, SensorPlan, StreamPlan
from becalm.live.address import Address, seconds_of

if TYPE_CHECKING:
    from becalm.cli.commands.fleet import SparkAddress


class TimeoutOptions(NamedTuple):
    """The options that are times, as they were typed."""

    lateness: str
    silent: str | None
    every: str


class FleetStreamOptions(NamedTuple):
    """The options of a stream."""

    recipe: Path | None
    recipes: Path | None
    key: str
    time: str
    times: TimeoutOptions
    checkpoint: str
    once: bool

    @property
    def book(self) -> LiveBook:
        """Return the recipes, which may change while the stream runs.

        Raises
        ------
        UsageError
            If neither or both of --recipe and --recipes were given.
        """
        paths = [path for path in (self.recipe, self.recipes) if path is not None]
        if len(paths) != 1:
            raise UsageError("Give one recipe with --recipe R.toml, or a folder of recipes with --recipes DIR.")
        return LiveBook(paths[0].resolve(), self.key)


@contextmanager
def _locked_output(plan: StreamPlan) -> Iterator[None]:
    """Lock a local output in a `with`. A remote one is not locked; of two streams into it, Spark ends the first."""
    if "://" in plan.output:
        yield
        return
    place = Path(plan.output)
    make_folder(place)
    with lock_output(place, place / "_becalm.lock"):
        yield


def stream_sensors(source: str, output: str, asking: FleetStreamOptions, where: SparkAddress) -> None:
    """Run a stream until it ends.

    Raises
    ------
    BecalmError
        If the stream cannot start, or fails; a restart continues from the last commit.
    """
    times = asking.times
    sensors = SensorPlan(
        asking.book,
        asking.key,
        asking.time,
        lateness_s=seconds_of("--lateness", times.lateness),
        silent_s=None if times.silent is None else seconds_of("--silent", times.silent),
    ).with_channels()
    every_s = seconds_of("--every", times.every)
    plan = StreamPlan(source, output, sensors, asking.checkpoint, every_s, once=asking.once)
    with spark_at(where, schedules=False) as spark:
        from becalm.fleet.stream import prepared, wait

        begin = prepared(spark, plan)
        shown = Address.parsed(source) if "://" in source else source  # without secrets
        typer.echo(f"Streams {shown} into {output}; a restart continues from the last commit.", err=True)
        with _locked_output(plan):
            wait(begin())
