"""Serve the counts of a stream to Prometheus over HTTP, on the loopback address unless another is given."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, get_args

from becalm.errors import UsageError
from becalm.live.closing import Closing
from becalm.live.optional_libraries import import_optional
from becalm.live.watching.meter import Meter, State

if TYPE_CHECKING:
    from prometheus_client.metrics_core import Metric

LOOPBACK = "127.0.0.1"


class MetricsServer(Closing):
    """A server of http://HOST:PORT/metrics in a separate thread, with the meter's current counts.

    Parameters
    ----------
    port : int
        Port to listen at; 0 takes a free port, which the attribute `port` then holds.
    meter : Meter
        Meter with the counts.
    host : str
        Address to listen at; with the default only this machine can connect.

    Raises
    ------
    UsageError
        If the port is not available, or prometheus-client is not installed.
    """

    def __init__(self, port: int, meter: Meter, host: str = LOOPBACK) -> None:
        library = import_optional("--metrics", "prometheus_client", "prometheus-client")
        registry = library.CollectorRegistry()
        registry.register(Counts(meter))
        library.ProcessCollector(registry=registry)  # memory, processor time, open files
        try:
            self._server, self._thread = library.start_http_server(port, host, registry)
        except (OSError, OverflowError) as cause:
            why = getattr(cause, "strerror", None) or cause
            raise UsageError(
                f"Metrics cannot be served at {host}:{port} ({why}); choose another port with --metrics."
            ) from cause
        self.port = int(self._server.server_port)

    def close(self) -> None:
        """Stop the server; may be called twice."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class Counts:
    """A Prometheus collector that reads a meter.

    Parameters
    ----------
    meter : Meter
        Meter with the counts.
    """

    def __init__(self, meter: Meter) -> None:
        self._meter = meter

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics with their current values."""
        status = self._meter.status()
        yield _counter("becalm_rows_taken", "Rows read from the source.", status["rows_taken"])
        yield _counter("becalm_rows", "Rows passed to the sinks.", status["rows"])
        yield _gauge("becalm_queue_blocks", "Blocks in the queue before the filter.", status["queue"]["blocks"])
        yield _gauge("becalm_queue_rows", "Rows in the queue before the filter.", status["queue"]["rows"])
        yield _gauge("becalm_loop_age_seconds", "Time since the last turn of the main loop.", status["loop_age_s"])
        yield _latency(status["latency_ms"])
        yield from _channels(status["channels"])
        yield from _losses(status["losses"])
        yield from _commits(status["commits"])
        yield _state_gauge(
            "becalm_state", "State of the stream.", {state: state == status["state"] for state in get_args(State)}
        )


def _counter(name: str, text: str, count: int) -> Metric:
    from prometheus_client.metrics_core import CounterMetricFamily

    return CounterMetricFamily(name, text, count)


def _gauge(name: str, text: str, value: float) -> Metric:
    from prometheus_client.metrics_core import GaugeMetricFamily

    return GaugeMetricFamily(name, text, value)


def _state_gauge(name: str, text: str, values: dict[str, bool]) -> Metric:
    from prometheus_client.metrics_core import GaugeMetricFamily

    family = GaugeMetricFamily(name, text, labels=["state"])
    for state, value in values.items():
        family.add_metric([state], float(value))
    return family


def _latency(latency: dict[str, Any]) -> Metric:
    """Return a summary: quantiles of the last outputs, and the sum of all latencies in seconds."""
    from prometheus_client.metrics_core import SummaryMetricFamily

    name = "becalm_latency_seconds"
    family = SummaryMetricFamily(
        name,
        "Time from the arrival of a reading until it is passed to the sinks.",
        count_value=latency["outputs"],
        sum_value=latency["sum"] / 1e3,
    )
    for quantile, percentile in (("0.5", "p50"), ("0.99", "p99"), ("1", "max")):
        if latency[percentile] is not None:
            family.add_sample(name, {"quantile": quantile}, latency[percentile] / 1e3)
    return family


def _channels(channels: dict[str, Any]) -> Iterator[Metric]:
    from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily

    verdicts = CounterMetricFamily("becalm_verdicts", "Readings by verdict.", labels=["channel", "verdict"])
    nis = GaugeMetricFamily("becalm_nis", "Squared innovations over their variance; 1 is right.", labels=["channel"])
    alarms = GaugeMetricFamily("becalm_alarms", "Current alarms of a channel.", labels=["channel", "alarm"])
    for name, channel in channels.items():
        for verdict, count in channel["verdicts"].items():
            verdicts.add_metric([name, verdict], count)
        if channel["nis"] is not None:
            nis.add_metric([name], channel["nis"])
        for alarm in channel["alarms"]:
            alarms.add_metric([name, alarm], 1)
    yield from (verdicts, nis, alarms)


def _losses(losses: dict[str, Any]) -> Iterator[Metric]:
    from prometheus_client.metrics_core import CounterMetricFamily

    events = CounterMetricFamily("becalm_losses", "Losses by kind.", labels=["kind"])
    rows = CounterMetricFamily("becalm_lost_rows", "Rows affected by losses, where known.", labels=["kind"])
    for kind, counts in losses.items():
        events.add_metric([kind], counts["events"])
        rows.add_metric([kind], counts["rows"])
    yield from (events, rows)


def _commits(commits: dict[str, Any]) -> Iterator[Metric]:
    yield _counter("becalm_commits", "Commits of rows and state.", commits["count"])
    yield _counter("becalm_kept_rows", "Rows committed.", commits["rows"])
    yield _gauge("becalm_longest_commit_seconds", "Longest duration of a commit.", commits["longest_took_ms"] / 1e3)
    if commits["last_age_s"] is not None:
        yield _gauge("becalm_last_commit_age_seconds", "Time since the last commit.", commits["last_age_s"])
