"""Run a live stream: check the options, then filter until the stream ends or a signal arrives."""

from __future__ import annotations

import signal
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple, cast, get_args
from urllib.parse import urlencode

import typer

from becalm.cleaning.pipeline import fit_to_recording, in_mode
from becalm.cleaning.recipes.recipe import Recipe
from becalm.cli.stopping import call_in_thread, stop_cleanly
from becalm.errors import BecalmError, UsageError
from becalm.live.address import Address, seconds_of
from becalm.live.buffered_sink import BufferedSink
from becalm.live.protocols import CheckpointSink, Sink, Source
from becalm.live.registry import open_sink, open_source
from becalm.live.running.commit_thread import StreamSinks
from becalm.live.running.learning_buffer import Learner
from becalm.live.running.queueing import Policy
from becalm.live.running.retuning import Retune
from becalm.live.running.runner import Runner
from becalm.live.running.settings import Settings
from becalm.live.running.stream_start import StreamStarter
from becalm.live.watching.logs import Log
from becalm.live.watching.meter import Meter
from becalm.live.watching.metrics import MetricsServer
from becalm.live.watching.status import StatusFile
from becalm.live.watching.watch import Watch
from becalm.web.access import PageOptions

DEFAULT_SINK = "journal:becalm-journal"
POLICIES = get_args(Policy)
_TIMED_BY_RECIPE = ("replay", "stdin", "serial")  # sources that take the time options of a recipe
_GATHER_S, _GATHER_SHARE = 0.05, 0.05  # longest gathering of datagrams: seconds, share of a commit interval
_LEARNED = "learned.recipe.toml"  # file name of a recipe that was tuned on the stream


class MonitoringOptions(NamedTuple):
    """The options for status, metrics, log and page."""

    status: Path | None
    metrics: int | None
    log: str
    silent: str
    page: PageOptions | None = None


class StreamError(BecalmError):
    """An unexpected error of a stream; all committed rows are intact."""

    exit_code = 1


class LiveOptions(NamedTuple):
    """The options for the filters."""

    recipe: Path | None
    learn: str  # duration of tuning, as it was typed
    lag_s: float | None
    channels: tuple[str, ...]


def settings_of(queue_blocks: int, when_full: str, commit: str) -> Settings:
    """Return the settings of a stream's queue and commits.

    Raises
    ------
    UsageError
        If an option is invalid.
    """
    if queue_blocks < 1:
        raise UsageError(f"--queue {queue_blocks} is too small; give 1 or more blocks.")
    if when_full not in POLICIES:
        raise UsageError(f"--when-full {when_full} is not one of {', '.join(POLICIES)}.")
    return Settings(seconds_of("--commit", commit), queue_blocks, cast(Policy, when_full))


def run(source: str, sinks: list[str], asking: LiveOptions, settings: Settings, monitoring: MonitoringOptions) -> None:
    """Run a live stream until it ends or a signal arrives.

    Raises
    ------
    BecalmError
        If an option is invalid, or the stream fails.
    """
    load = None if asking.recipe is None else partial(_recipe_of, asking.recipe, asking)
    recipe = None if load is None else load()
    timed_source = source if recipe is None else _with_time(source, recipe)
    address, names = str(Address.parsed(timed_source)), sinks or [DEFAULT_SINK]
    checkpoint_sink, other_sinks = _split_sinks([open_sink(name) for name in names])
    gather_s = 0.0 if other_sinks or monitoring.page else min(_GATHER_S, _GATHER_SHARE * settings.commit_s)
    source_reader = _open_source(timed_source, gather_s)
    learner = Learner(seconds_of("--learn", asking.learn), asking.lag_s, asking.channels)
    meter = Meter(address)
    with ExitStack() as stack:
        log = stack.enter_context(Log(monitoring.log))
        watch = Watch(meter, log, seconds_of("--silent", monitoring.silent))
        stack.callback(watch.close)
        if monitoring.metrics is not None:
            stack.enter_context(MetricsServer(monitoring.metrics, meter))
        if monitoring.status is not None:
            stack.enter_context(StatusFile(monitoring.status, meter, log.warning))
        if monitoring.page is not None:
            other_sinks.append(_page(monitoring.page, meter, lambda *asked: runner.retune(*asked), log, stack))
        runner = Runner(
            source=source_reader,
            address=address,
            sinks=StreamSinks(checkpoint_sink, tuple(BufferedSink(sink) for sink in other_sinks)),
            watch=watch,
            starter=StreamStarter(
                recipe,
                learner,
                on_learned=partial(_save, path=_learned_path(names), log=log),
                make_source=None if recipe is not None else lambda had: _open_source(_with_time(source, had), gather_s),
            ),
            settings=settings,
        )
        _handle_signals(runner, load)
        log.info("start", source=address, sinks=", ".join(str(Address.parsed(name)) for name in names))
        _run_logged(runner, log)
    _print_message(f"Filtered {runner.rows} rows of {address}.")


def _page(options: PageOptions, meter: Meter, retune: Retune, log: Log, stack: ExitStack) -> Sink:
    """Serve the live page; return its sink."""
    from becalm.web.needed_libraries import need_app

    need_app()
    from becalm.cli.commands.live_page import serve

    served = serve(options, meter, retune, log.warning, stack)
    for line in served.says:
        _print_message(line)
    return served.feed


def _recipe_of(path: Path, asking: LiveOptions) -> Recipe:
    """Return a recipe with the channels and the lag of the options, if they are given."""
    recipe = in_mode(Recipe.load(path), lag_s=asking.lag_s)
    names, units = zip(*((channel.name, channel.unit) for channel in recipe.channel), strict=True)
    return fit_to_recording(recipe, names, units, channels=asking.channels or None)


def _with_time(source: str, recipe: Recipe) -> str:
    """Return a source's address with the recipe's time options, unless it has its own or its kind takes none."""
    address = Address.parsed(source)
    if address.kind not in _TIMED_BY_RECIPE or not {"rate", "time"}.isdisjoint(address.options):
        return source
    options: dict[str, Any] = {"rate": recipe.rate_hz} if recipe.rate_hz is not None else {"time": recipe.time}
    if address.kind == "replay" and "stamps" not in address.options:
        options["stamps"] = recipe.stamps
    query = urlencode({name: value for name, value in options.items() if value is not None})
    return f"{source}{'&' if address.options else '?'}{query}" if query else source


def _open_source(source: str, gather_s: float) -> Source:
    """Open a source; a UDP source without a gather option gathers datagrams for `gather_s` seconds, if not 0."""
    address = Address.parsed(source)
    if gather_s and address.kind == "udp" and "gather" not in address.options:
        source = f"{source}{'&' if address.options else '?'}gather={gather_s:.6f}s"
    return open_source(source)


def _run_logged(runner: Runner, log: Log) -> None:
    """Run a stream; log an unexpected error in full, and raise it as a StreamError of one sentence."""
    try:
        runner.run()
    except BecalmError as cause:
        runner.watch.state("failed", str(cause))
        raise
    except Exception as cause:
        runner.watch.state("failed", type(cause).__name__)
        raise StreamError(log.unexpected(cause)) from cause


def _split_sinks(sinks: list[Sink | CheckpointSink]) -> tuple[CheckpointSink | None, list[Sink]]:
    checkpoint_sinks = [sink for sink in sinks if isinstance(sink, CheckpointSink)]
    if len(checkpoint_sinks) > 1:
        raise UsageError("Only one sink can store a stream's state; give one of journal:, postgres: and delta:.")
    return (checkpoint_sinks[0] if checkpoint_sinks else None), [sink for sink in sinks if isinstance(sink, Sink)]


def _learned_path(sinks: list[str]) -> Path:
    journals = [Address.parsed(name).rest for name in sinks if name.startswith("journal:")]
    return Path(journals[0] if journals else ".") / _LEARNED


def _save(recipe: Recipe, *, path: Path, log: Log) -> None:
    from becalm.files.atomic_file import write_text

    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, recipe.to_toml())
    log.info("learned", recipe=str(path))
    _print_message(f"Tuned a filter and wrote {path}.")


def _print_message(text: str) -> None:
    """Print a message; a closed terminal does not stop the stream."""
    with suppress(OSError):
        typer.echo(text, err=True)


def _handle_signals(runner: Runner, load: Callable[[], Recipe] | None) -> None:
    """Handle signals: stop after a commit at the first, at once at the second; at SIGHUP, reload the recipe, if any."""
    end = call_in_thread(runner.stop)
    retune = end if load is None else call_in_thread(partial(runner.retune, load))

    def stop(number: int, frame: FrameType | None) -> None:
        stop_cleanly()
        end()

    def reload(number: int, frame: FrameType | None) -> None:
        if load is None:
            stop_cleanly()
        retune()

    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, stop)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, reload)
