"""Counts of a stream for Prometheus, over HTTP on loopback."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, get_args

from becalm.errors import UsageError
from becalm.live.closing import Closing
from becalm.live.optional_libraries import wanted
from becalm.live.watching.meter import Meter, State

if TYPE_CHECKING:
    from prometheus_client.metrics_core import Metric

LOOPBACK = "127.0.0.1"


class MetricsServer(Closing):
    """Answers http://HOST:PORT/metrics from a thread of its own, with what the meter says at that moment.

    Parameters
    ----------
    port : int
        Where to listen; 0 takes any that is free, which `port` then tells.
    meter : Meter
        What to tell.
    host : str
        Who may ask: this machine, unless another address is named.

    Raises
    ------
    UsageError
        If the port cannot be had, or prometheus-client is not here.
    """

    def __init__(self, port: int, meter: Meter, host: str = LOOPBACK) -> None:
        library = wanted("--metrics", "prometheus_client", "prometheus-client")
        registry = library.CollectorRegistry()
        registry.register(Counts(meter))
        library.ProcessCollector(registry=registry)  # memory, processor time, open files
        try:
            self._server, self._thread = library.start_http_server(port, host, registry)
        except (OSError, OverflowError) as cause:
            why = getattr(cause, "strerror", None) or cause
            raise UsageError(
                f"Metrics cannot be told at {host}:{port} ({why}); name another with --metrics."
            ) from cause
        self.port = int(self._server.server_port)

    def close(self) -> None:
        """Stop answering; harmless twice."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class Counts:
    """The meter as Prometheus sees it: nothing is counted here.

    Parameters
    ----------
    meter : Meter
        What to tell.
    """

    def __init__(self, meter: Meter) -> None:
        self._meter = meter

    def collect(self) -> Iterator[Metric]:
        """Tell all metrics as of now."""
        told = self._meter.status()
        yield _total("becalm_rows_taken", "Rows that came from the source.", told["rows_taken"])
        yield _total("becalm_rows", "Rows that sinks have got.", told["rows"])
        yield _now("becalm_queue_blocks", "Blocks that wait for the filter.", told["queue"]["blocks"])
        yield _now("becalm_queue_rows", "Rows that wait for the filter.", told["queue"]["rows"])
        yield _now("becalm_loop_age_seconds", "Time since the main loop last came round.", told["loop_age_s"])
        yield _latency(told["latency_ms"])
        yield from _channels(told["channels"])
        yield from _losses(told["losses"])
        yield from _commits(told["commits"])
        yield _labelled(
            "becalm_state", "What the stream is doing.", {state: state == told["state"] for state in get_args(State)}
        )


def _total(name: str, says: str, count: int) -> Metric:
    from prometheus_client.metrics_core import CounterMetricFamily

    return CounterMetricFamily(name, says, count)


def _now(name: str, says: str, value: float) -> Metric:
    from prometheus_client.metrics_core import GaugeMetricFamily

    return GaugeMetricFamily(name, says, value)


def _labelled(name: str, says: str, values: dict[str, bool]) -> Metric:
    from prometheus_client.metrics_core import GaugeMetricFamily

    family = GaugeMetricFamily(name, says, labels=["state"])
    for state, value in values.items():
        family.add_metric([state], float(value))
    return family


def _latency(told: dict[str, Any]) -> Metric:
    """Return a summary: quantiles of the last outputs, and the sum of all."""
    from prometheus_client.metrics_core import SummaryMetricFamily

    name = "becalm_latency_seconds"
    family = SummaryMetricFamily(
        name,
        "From a reading's arrival until sinks have it.",
        count_value=told["outputs"],
        sum_value=told["sum"] / 1e3,
    )
    for quantile, percentile in (("0.5", "p50"), ("0.99", "p99"), ("1", "max")):
        if told[percentile] is not None:
            family.add_sample(name, {"quantile": quantile}, told[percentile] / 1e3)
    return family


def _channels(told: dict[str, Any]) -> Iterator[Metric]:
    from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily

    verdicts = CounterMetricFamily("becalm_verdicts", "Readings by what became of them.", labels=["channel", "verdict"])
    nis = GaugeMetricFamily("becalm_nis", "Innovations squared over their variance; 1 is right.", labels=["channel"])
    alarms = GaugeMetricFamily("becalm_alarms", "What is wrong with a channel now.", labels=["channel", "alarm"])
    for name, channel in told.items():
        for verdict, count in channel["verdicts"].items():
            verdicts.add_metric([name, verdict], count)
        if channel["nis"] is not None:
            nis.add_metric([name], channel["nis"])
        for alarm in channel["alarms"]:
            alarms.add_metric([name, alarm], 1)
    yield from (verdicts, nis, alarms)


def _losses(told: dict[str, Any]) -> Iterator[Metric]:
    from prometheus_client.metrics_core import CounterMetricFamily

    events = CounterMetricFamily("becalm_losses", "Losses, by what happened.", labels=["kind"])
    rows = CounterMetricFamily("becalm_lost_rows", "Rows that losses touched, where known.", labels=["kind"])
    for kind, losses in told.items():
        events.add_metric([kind], losses["events"])
        rows.add_metric([kind], losses["rows"])
    yield from (events, rows)


def _commits(told: dict[str, Any]) -> Iterator[Metric]:
    yield _total("becalm_commits", "Commits of rows and state.", told["count"])
    yield _total("becalm_kept_rows", "Rows that are kept for good.", told["rows"])
    yield _now("becalm_longest_commit_seconds", "The longest that a commit took.", told["longest_took_ms"] / 1e3)
    if told["last_age_s"] is not None:
        yield _now("becalm_last_commit_age_seconds", "Time since the last commit.", told["last_age_s"])
