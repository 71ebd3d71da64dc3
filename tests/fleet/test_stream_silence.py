"""A sensor of which nothing comes: said once, and its end, by the clock of the engine."""

from __future__ import annotations

from dataclasses import replace

from becalm.fleet.stream.blocks import SensorRows
from becalm.fleet.stream.sensor import SensorStreamProcessor
from streaming import CHANNELS, assert_same_bits, by_stream, part, rows_of, walker


def test_silence_is_said_once_and_its_end() -> None:
    rows, one = rows_of(400), walker(silent_s=60.0)
    one.now_ms = 1_000_000
    first = one.hear(part(rows, slice(0, 100)))
    assert first.timer_ms == 1_060_000
    one.now_ms = 1_030_000
    assert one.hear(part(rows, slice(100, 120))).timer_ms is None  # the first look is to come
    one.now_ms = 1_060_500
    step = one.wake()
    assert (step.events, step.timer_ms) == ((), 1_090_000)
    one.now_ms = 1_090_000
    step = one.wake()
    assert ([event.kind for event in step.events], step.timer_ms) == (["silent"], None)
    one.now_ms = 2_000_000
    assert one.wake().events == ()
    step = one.hear(part(rows, slice(120, 400)))
    assert step.events[0].kind == "back"
    assert "970 s" in step.events[0].says
    assert step.timer_ms == 2_060_000
    assert_same_bits(one.said, by_stream(rows))


def test_a_stream_that_looks_for_silence_now_or_no_longer() -> None:
    rows, one = rows_of(300), walker()
    one.hear(part(rows, slice(0, 100)))
    one._walk = SensorStreamProcessor(replace(one.plan, silent_s=60.0), CHANNELS)  # it was begun again
    assert one.hear(part(rows, slice(100, 200))).timer_ms == 60_000
    one._walk = SensorStreamProcessor(one.plan, CHANNELS)
    one.now_ms = 60_000
    step = one.wake()
    assert (step.estimates, step.events, step.timer_ms) == (None, (), None)
    one._walk = SensorStreamProcessor(replace(one.plan, silent_s=60.0), CHANNELS)
    assert one.hear(part(rows, slice(200, 300))).timer_ms == 120_000


def test_silence_tells_rows_that_wait_for_late_ones() -> None:
    rows, one = rows_of(100), walker(silent_s=5.0, lateness_s=0.3)
    assert one.hear(rows).estimates is not None
    waiting = 100 - len(one.said.time_s)
    assert waiting > 0
    one.now_ms = 5000
    step = one.wake()
    assert step.estimates is not None
    assert len(step.estimates.time_s) == waiting
    assert_same_bits(one.said, by_stream(rows))


def test_rows_that_wait_for_channels_that_are_no_more_are_left_out_and_counted() -> None:
    rows, one = rows_of(100), walker(silent_s=5.0, lateness_s=0.3)
    one.hear(rows)
    waiting = 100 - len(one.said.time_s)
    one._walk = SensorStreamProcessor(one.plan, ("c",))  # it was begun again, with others
    one.now_ms = 5000
    events = one.wake().events
    assert [(event.kind, event.rows) for event in events] == [("silent", None), ("refused", waiting)]
    assert "the stream has 'c'" in events[1].says


def test_after_silence_stamps_may_be_as_late_as_they_like() -> None:
    rows, one = rows_of(100), walker(silent_s=5.0)
    one.hear(rows)
    one.now_ms = 5000
    one.wake()
    later = SensorRows(rows.time_s + 3 * 86400.0, rows.values)
    one.hear(later)
    assert len(one.said.time_s) == 200
