"""Metrics: what Prometheus reads is what the meter counted."""

from __future__ import annotations

import urllib.request

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from becalm.core.reading_verdicts import Verdict
from becalm.errors import UsageError
from becalm.live.block import Loss, LossKind
from becalm.live.watching.meter import Meter
from becalm.live.watching.metrics import MetricsServer
from metered import Clock, block_of, metered, output_of, used

Scraped = dict[tuple[str, frozenset[tuple[str, str]]], float]


def scraped(server: MetricsServer) -> Scraped:
    with urllib.request.urlopen(f"http://127.0.0.1:{server.port}/metrics", timeout=30) as answer:
        text = answer.read().decode()
    samples = [sample for family in text_string_to_metric_families(text) for sample in family.samples]
    return {(sample.name, frozenset(sample.labels.items())): sample.value for sample in samples}


def of(found: Scraped, name: str, **labels: str) -> float:
    return found[name, frozenset(labels.items())]


def test_what_is_scraped_is_what_was_counted() -> None:
    clock = Clock()
    meter = metered(clock=clock)
    verdicts = np.zeros((10, 2), np.int8)
    verdicts[3:5, 1] = Verdict.SPIKE
    meter.count_block(block_of(12))
    meter.set_queue(2, 20)
    meter.record(output_of(verdicts, clock.now_s - 0.25, [Loss(LossKind.MISSING, 3, "Three.")]))
    meter.count_commit(10, 0.5)
    meter.health("ax", 1.5, ["drift"])
    meter.state("running")
    clock.now_s += 4
    with MetricsServer(0, meter) as server:
        found = scraped(server)
        assert of(found, "becalm_rows_taken_total") == 12
        assert of(found, "becalm_rows_total") == 10
        assert of(found, "becalm_queue_blocks") == 2
        assert of(found, "becalm_queue_rows") == 20
        assert of(found, "becalm_loop_age_seconds") == 4
        assert of(found, "becalm_latency_seconds_count") == 1
        for name, labels in (
            ("sum", {}),
            ("", {"quantile": "0.5"}),
            ("", {"quantile": "0.99"}),
            ("", {"quantile": "1"}),
        ):
            assert of(found, f"becalm_latency_seconds_{name}".rstrip("_"), **labels) == pytest.approx(0.25)
        assert of(found, "becalm_verdicts_total", channel="ay", verdict="used") == 8
        assert of(found, "becalm_verdicts_total", channel="ay", verdict="spike") == 2
        assert of(found, "becalm_nis", channel="ax") == 1.5
        assert ("becalm_nis", frozenset({("channel", "ay")})) not in found
        assert of(found, "becalm_alarms", channel="ax", alarm="drift") == 1
        assert of(found, "becalm_losses_total", kind="missing") == 1
        assert of(found, "becalm_lost_rows_total", kind="missing") == 3
        assert of(found, "becalm_losses_total", kind="gap") == 0
        assert of(found, "becalm_commits_total") == 1
        assert of(found, "becalm_kept_rows_total") == 10
        assert of(found, "becalm_longest_commit_seconds") == 0.5
        assert of(found, "becalm_last_commit_age_seconds") == 4
        assert of(found, "becalm_state", state="running") == 1
        assert of(found, "becalm_state", state="away") == 0
        meter.record(used(5, clock.now_s))
        assert of(scraped(server), "becalm_rows_total") == 15


def test_a_stream_without_rows_or_commits_can_be_asked() -> None:
    with MetricsServer(0, Meter()) as server:
        found = scraped(server)
    assert of(found, "becalm_rows_total") == 0
    assert not any(name == "becalm_last_commit_age_seconds" for name, _ in found)


def test_any_name_of_a_channel_comes_through() -> None:
    name = 'µ "a"\\b\n{c=d}'
    meter = metered((name,))
    meter.health(name, 2.0)
    with MetricsServer(0, meter) as server:
        assert of(scraped(server), "becalm_nis", channel=name) == 2


def test_a_port_in_use_is_said_in_a_sentence() -> None:
    with MetricsServer(0, metered()) as first, pytest.raises(UsageError, match=r"127.0.0.1:\d+ .*choose another"):
        MetricsServer(first.port, metered())


@pytest.mark.parametrize("port", [-1, 70_000])
def test_no_such_port_is_said_in_a_sentence(port: int) -> None:
    with pytest.raises(UsageError, match=f"127.0.0.1:{port} .*choose another"):
        MetricsServer(port, metered())


def test_closed_it_answers_no_more_and_its_port_is_free() -> None:
    server = MetricsServer(0, metered())
    server.close()
    server.close()
    MetricsServer(server.port, metered()).close()
