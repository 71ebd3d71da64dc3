"""Streams over a fleet, on Spark, until they end, fail or are stopped."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from becalm.cli.fleet import spark_at
from becalm.errors import UsageError
from becalm.files.text_file import make_folder
from becalm.fleet.output_lock import alone_at
from becalm.fleet.stream import LiveBook, SensorPlan, StreamPlan
from becalm.live.address import Address, seconds_of

if TYPE_CHECKING:
    from becalm.cli.fleet import SparkAddress


class TimeoutOptions(NamedTuple):
    """How long is waited for what, as it was typed."""

    lateness: str
    silent: str | None
    every: str


class FleetStreamOptions(NamedTuple):
    """What is asked of a stream."""

    recipe: Path | None
    recipes: Path | None
    key: str
    time: str
    times: TimeoutOptions
    checkpoint: str
    once: bool

    @property
    def book(self) -> LiveBook:
        """The recipes, which may change while it runs.

        Raises
        ------
        UsageError
            If none were named, or both kinds.
        """
        named = [path for path in (self.recipe, self.recipes) if path is not None]
        if len(named) != 1:
            raise UsageError("Name one recipe with --recipe R.toml, or a folder of them with --recipes DIR.")
        return LiveBook(named[0].resolve(), self.key)


@contextmanager
def _alone(plan: StreamPlan) -> Iterator[None]:
    """Keep another stream of this machine from the output; where it is on no disk, Spark ends the first of two."""
    if "://" in plan.output:
        yield
        return
    place = Path(plan.output)
    make_folder(place)
    with alone_at(place, place / "_becalm.lock"):
        yield


def stream_sensors(source: str, output: str, asking: FleetStreamOptions, where: SparkAddress) -> None:
    """Run a stream to its end.

    Raises
    ------
    BecalmError
        If it cannot be begun, or fails; begun again, it goes on where it was.
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
        typer.echo(f"Streams {shown} into {output}; begun again after a stop, it goes on where it was.", err=True)
        with _alone(plan):
            wait(begin())
