"""The meter counts what goes by, whoever tells it, and whenever it is asked."""

from __future__ import annotations

import json
import math
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from becalm.core.reading_verdicts import Verdict
from becalm.live.block import Loss, LossKind
from becalm.live.watching import memory
from becalm.live.watching.meter import LATENCIES
from metered import NAMES, Clock, block_of, metered, output_of, used


def test_rows_are_counted_where_they_come_and_where_they_go() -> None:
    clock = Clock()
    meter = metered(clock=clock)
    meter.count_block(block_of(7))
    meter.count_block(block_of(0))
    meter.set_queue(3, 30)
    meter.record(used(5, clock.now_s))
    told = meter.status()
    assert (told["rows_taken"], told["rows"]) == (7, 5)
    assert told["queue"] == {"blocks": 3, "rows": 30}


@given(st.lists(st.tuples(st.sampled_from(Verdict), st.sampled_from(Verdict)), min_size=1))
def test_verdicts_are_counted_by_channel(rows: list[tuple[Verdict, Verdict]]) -> None:
    clock = Clock()
    meter = metered(clock=clock)
    for part in (rows[:1], rows[1:]):
        meter.record(output_of(np.array(part, np.int8).reshape(-1, 2), clock.now_s))
    for channel, name in enumerate(NAMES):
        met = [row[channel].name.lower() for row in rows]
        assert meter.status()["channels"][name]["verdicts"] == {word: met.count(word) for word in set(met)}


def test_latencies_are_those_of_the_last_outputs() -> None:
    clock = Clock()
    meter = metered(clock=clock)
    meter.record(used(1, clock.now_s - 5.0))
    for tenth_ms in range(LATENCIES):
        meter.record(used(1, clock.now_s - tenth_ms * 1e-4))
    told = meter.status()["latency_ms"]
    wanted = np.percentile(np.arange(LATENCIES) * 0.1, [50, 99, 100])
    np.testing.assert_allclose([told["p50"], told["p99"], told["max"]], wanted, atol=1e-3)
    assert told["longest_ever"] == pytest.approx(5000)
    assert told["outputs"] == LATENCIES + 1


def test_an_output_without_rows_has_no_latency() -> None:
    meter = metered()
    meter.record(used(0, 0.0))
    assert meter.status()["latency_ms"]["outputs"] == 0
    assert meter.status()["latency_ms"]["p99"] is None


def test_rows_that_the_end_of_a_stream_brings_have_no_latency() -> None:
    clock = Clock()
    meter = metered(clock=clock)
    meter.record(used(1, clock.now_s - 0.5))
    meter.record(used(20, 0.0))
    assert meter.status()["latency_ms"]["outputs"] == 1
    assert meter.status()["latency_ms"]["longest_ever"] == pytest.approx(500)


def test_the_rate_is_that_of_the_last_ten_seconds() -> None:
    clock = Clock()
    meter = metered(clock=clock)
    assert meter.status()["rows_per_s"] == 0
    for _ in range(60):
        for _ in range(4):
            meter.record(used(25, clock.now_s))
            clock.now_s += 0.25
    assert meter.status()["rows_per_s"] == 100
    clock.now_s += 5
    assert meter.status()["rows_per_s"] == 50
    clock.now_s += 50
    assert meter.status()["rows_per_s"] == 0


def test_a_young_stream_has_the_rate_of_its_own_seconds() -> None:
    clock = Clock()
    meter = metered(clock=clock)
    for _ in range(3):
        meter.record(used(40, clock.now_s))
        clock.now_s += 1
    assert meter.status()["rows_per_s"] == 40


def test_losses_are_counted_when_they_are_told() -> None:
    meter = metered(clock=Clock())
    gap = Loss(LossKind.GAP, None, "A pause.", noticed_s=86_400.0)
    missing = Loss(LossKind.MISSING, 3, "Rows 4 to 6 never came.")
    meter.count_block(block_of(2, [missing, gap]))  # of which the output tells
    meter.record(output_of(np.zeros((2, 2), np.int8), 1000.0, [missing, gap]))
    meter.record(output_of(np.zeros((0, 2), np.int8), 1000.0, [Loss(LossKind.MISSING, 2, "Rows 9 to 10 never came.")]))
    losses = meter.status()["losses"]
    assert losses["missing"]["events"] == 2
    assert losses["missing"]["rows"] == 5
    assert losses["missing"]["says"] == "Rows 9 to 10 never came."
    assert losses["gap"] == {"events": 1, "rows": 0, "says": "A pause.", "at": "1970-01-02T00:00:00.000+00:00"}
    assert losses["late"] == {"events": 0, "rows": 0, "says": "", "at": None}


def test_commits_tell_how_old_the_last_is_and_where_it_stands() -> None:
    clock = Clock()
    meter = metered(clock=clock)
    assert meter.status()["commits"]["last_age_s"] is None
    meter.count_commit(100, 0.02, '{"row": 100}')
    meter.count_commit(50, 0.01, '{"row": 150}')
    clock.now_s += 2.5
    told = meter.status()
    assert told["commits"] == {"count": 2, "rows": 150, "last_age_s": 2.5, "last_took_ms": 10, "longest_took_ms": 20}
    assert told["position"] == '{"row": 150}'


def test_the_time_of_a_state_is_that_of_its_change(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.time", Clock(0.0))
    meter = metered()
    monkeypatch.setattr("time.time", Clock(60.0))
    meter.state("away", "No broker.")
    monkeypatch.setattr("time.time", Clock(120.0))
    meter.state("away", "Still none.")
    told = meter.status()
    assert (told["state"], told["says"]) == ("away", "Still none.")
    assert told["started"].startswith("1970-01-01T00:00:00")
    assert told["since"].startswith("1970-01-01T00:01:00")
    assert told["written"].startswith("1970-01-01T00:02:00")


def test_health_of_a_channel_is_told_or_unknown() -> None:
    meter = metered()
    meter.health("ax", 1.25, ["drift"])
    meter.health("ay", math.nan)
    channels = meter.status()["channels"]
    assert channels["ax"] == {"verdicts": {}, "nis": 1.25, "alarms": ["drift"]}
    assert channels["ay"] == {"verdicts": {}, "nis": None, "alarms": []}


def test_a_loop_that_does_not_turn_shows() -> None:
    clock = Clock()
    meter = metered(clock=clock)
    clock.now_s += 3
    assert meter.status()["loop_age_s"] == 3
    meter.record_iteration()
    assert meter.status()["loop_age_s"] == 0


def test_a_recipe_is_told_by_its_hash_only() -> None:
    meter = metered()
    assert meter.status()["recipe_sha256"] == ""
    meter.begin(NAMES, "version = 1")
    told = meter.status()
    assert len(told["recipe_sha256"]) == 64
    meter.begin(NAMES, "version = 2")
    assert meter.status()["recipe_sha256"] != told["recipe_sha256"]


def test_a_status_is_plain_json() -> None:
    meter = metered()
    meter.record(used(3, 0.0))
    told = meter.status()
    assert json.loads(json.dumps(told, allow_nan=False)) == told


def test_threads_lose_no_count() -> None:
    meter = metered()
    block, loss = block_of(1), Loss(LossKind.LATE, 1, "Late.")
    output = output_of(np.zeros((1, 2), np.int8), 0.0, [loss])

    def go() -> None:
        for _ in range(2000):
            meter.record(output)
            meter.count_block(block)

    threads = [threading.Thread(target=go) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    told = meter.status()
    assert (told["rows"], told["rows_taken"], told["losses"]["late"]["rows"]) == (8000, 8000, 8000)


def test_memory_is_told_as_the_system_tells_it(monkeypatch: pytest.MonkeyPatch) -> None:
    now = memory.resident_bytes()
    if now is None:
        pytest.skip("this system does not tell how much memory a process holds")
    held = np.ones(8_000_000)
    more = memory.resident_bytes()
    assert more is not None
    assert more - now > 0.8 * held.nbytes
    monkeypatch.setattr(memory, "Path", lambda _: Path("/nowhere/at/all"))
    most = memory.resident_bytes()  # as where there is no /proc
    assert most is not None
    assert most >= 0.9 * more
