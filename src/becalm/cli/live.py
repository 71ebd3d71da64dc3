"""A stream on the command line: what is asked is checked, then it runs until it ends or a signal stops it."""

from __future__ import annotations

import signal
import threading
from contextlib import ExitStack
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import typer

from becalm.cleaning.recipe import Recipe
from becalm.cli.stopping import stop_cleanly
from becalm.errors import UsageError
from becalm.live.address import Address, seconds_of
from becalm.live.keeping import Outlets
from becalm.live.learning import Learner
from becalm.live.outlet import Outlet
from becalm.live.protocols import Keeper, Sink
from becalm.live.registry import open_sink, open_source
from becalm.live.runner import Runner, Settings
from becalm.live.watching.logs import Log, open_log
from becalm.live.watching.meter import Meter
from becalm.live.watching.metrics import MetricsServer
from becalm.live.watching.status import StatusFile

DEFAULT_SINK = "journal:becalm-journal"
_LEARNED = "learned.recipe.toml"


class Watching(NamedTuple):
    """Where a stream can be watched."""

    status: Path | None
    metrics: int | None
    log: str


class Asking(NamedTuple):
    """What is asked of the filters."""

    recipe: Path | None
    learn: str
    lag_s: float | None
    channels: tuple[str, ...]


def run(source: str, sinks: list[str], asking: Asking, settings: Settings, watching: Watching) -> None:
    """Run a stream."""
    recipe = None if asking.recipe is None else Recipe.load(asking.recipe)
    address, made = str(Address.parsed(source)), open_source(source)
    names = sinks or [DEFAULT_SINK]
    keeper, others = _parted([open_sink(name) for name in names])
    learner = Learner(seconds_of("--learn", asking.learn), asking.lag_s, asking.channels)
    meter = Meter()
    meter.begin(address)
    with ExitStack() as open_now:
        log = open_now.enter_context(open_log(watching.log))
        meter.listen(log)
        if watching.metrics is not None:
            open_now.enter_context(MetricsServer(watching.metrics, meter))
        if watching.status is not None:
            open_now.enter_context(StatusFile(watching.status, meter))
        beside = _learned_path(names)
        runner = Runner(
            source=made,
            address=address,
            outlets=Outlets(keeper, tuple(Outlet(sink) for sink in others)),
            meter=meter,
            recipe=recipe,
            learner=learner,
            learned=lambda found: _save(found, beside, log),
            settings=settings,
            ready=_warming(recipe),
        )
        _hear_signals(runner, asking.recipe)
        runner.run()
    typer.echo(f"Told {runner.rows} rows of {address}.", err=True)


def _parted(sinks: list[Sink | Keeper]) -> tuple[Keeper | None, list[Sink]]:
    keepers = [sink for sink in sinks if isinstance(sink, Keeper)]
    if len(keepers) > 1:
        raise UsageError("Only one sink can keep a stream; name one of journal:, postgres: and delta:.")
    return (keepers[0] if keepers else None), [sink for sink in sinks if isinstance(sink, Sink)]


def _learned_path(sinks: list[str]) -> Path:
    journals = [Address.parsed(name).rest for name in sinks if name.startswith("journal:")]
    return Path(journals[0] if journals else ".") / _LEARNED


def _save(recipe: Recipe, path: Path, log: Log) -> None:
    from becalm.files.plain import write_text

    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, recipe.to_toml())
    log.info("learned", recipe=str(path))
    typer.echo(f"Learned a filter and wrote {path}.", err=True)


def _warming(recipe: Recipe | None) -> Callable[[], None]:
    """Load or compile kernels beside the opening of the source; return what waits for that."""
    if recipe is None:
        return lambda: None
    thread = threading.Thread(target=warm_up, args=(recipe,), daemon=True)
    thread.start()
    return thread.join


def _hear_signals(runner: Runner, recipe: Path | None) -> None:
    """Stop at the first signal to stop, finish the commit, and end at once at the second; reload the recipe at SIGHUP."""

    def stop(number: int, frame: FrameType | None) -> None:
        runner.stop()
        stop_cleanly()

    def reload(number: int, frame: FrameType | None) -> None:
        if recipe is None:
            stop(number, frame)
        else:
            runner.retune(Recipe.load(recipe))

    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, stop)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, reload)
