"""Stamps of a sensor that come late, twice, wrong, coarse or not at all."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.fleet.stream.blocks import SensorRows
from made import recipe_of
from streaming import BEGINS_S, CHANNELS, NOW_MS, RECIPE, assert_same_bits, by_stream, lagged, part, rows_of, walker


def test_late_and_repeated_rows_are_left_out_and_counted() -> None:
    rows, one = rows_of(300), walker(now_ms=NOW_MS)
    one.hear(part(rows, slice(0, 100)))
    one.hear(part(rows, slice(90, 200)), part(rows, slice(150, 160)))
    one.hear(part(rows, slice(200, 300)))
    assert_same_bits(one.said, by_stream(rows))
    assert sorted((event.kind, event.rows) for event in one.events if event.kind != "gap") == [
        ("late", 9),
        ("repeated", 11),
    ]


def test_a_late_file_is_no_clock_that_was_set_back() -> None:
    rows, one = rows_of(400), walker(now_ms=NOW_MS)
    one.hear(part(rows, slice(0, 100)))
    one.hear(part(rows, slice(200, 300)))
    assert one.hear(part(rows, slice(100, 200))).estimates is None
    one.hear(part(rows, slice(300, 400)))
    expected = np.r_[0:100, 200:400]
    assert_same_bits(one.said, by_stream(part(rows, list(expected))))
    assert ("late", 100) in [(event.kind, event.rows) for event in one.events]


@pytest.mark.parametrize("behind_s", [100.0, 3 * 86400.0])
@pytest.mark.parametrize("lag_s", [0.0, 0.2])
def test_rows_that_are_sent_again_are_told_once(behind_s: float, lag_s: float) -> None:
    """However old they are, alone in a micro-batch or not, and also those that a lag holds back."""
    rows, recipe = rows_of(400), lagged(lag_s) if lag_s else RECIPE
    one = walker(recipe, now_ms=NOW_MS + round(behind_s * 1000))
    old = SensorRows(rows.time_s[:50], rows.values[:50])
    new = SensorRows(rows.time_s + behind_s, rows.values)
    one.hear(old)
    one.hear(part(new, slice(0, 200)))
    one.hear(old)
    one.hear(part(new, slice(185, 200)))
    one.hear(part(new, slice(200, 400)))
    every = SensorRows(np.r_[old.time_s, new.time_s], np.vstack([old.values, new.values]))
    assert_same_bits(one.said, by_stream(every, recipe))
    assert [event.rows for event in one.events if event.kind == "late"] == [50, 14]


def test_a_clock_that_was_wrong_by_years_is_believed_again() -> None:
    rows, one = rows_of(400), walker(now_ms=NOW_MS)
    one.hear(part(rows, slice(0, 100)))
    wrong = part(rows, slice(100, 200))
    one.hear(SensorRows(wrong.time_s + 1e8, wrong.values))
    one.hear(part(rows, slice(200, 400)))
    assert [event.kind for event in one.events if event.kind != "gap"] == ["clock", "clock", "late", "clock"]
    assert len(one.said.time_s) == 400 - 14


def test_stamps_that_begin_anew_are_followed() -> None:
    rows, one = rows_of(300), walker()
    uptime = SensorRows(rows.time_s - BEGINS_S, rows.values)
    one.hear(uptime)
    one.hear(uptime)
    assert len(one.said.time_s) == 600 - 7
    assert "clock" in one.kinds()


def test_rows_without_a_stamp_are_counted() -> None:
    rows, one = rows_of(100), walker()
    one.hear(SensorRows(np.append(rows.time_s, [np.nan, np.nan]), np.vstack([rows.values, np.zeros((2, 2))])))
    assert_same_bits(one.said, by_stream(rows))
    assert ("garbled", 2) in [(event.kind, event.rows) for event in one.events]


def test_rows_without_stamps_are_not_kept() -> None:
    one = walker()
    for _ in range(3):
        one.hear(SensorRows(np.full(1000, np.nan), np.zeros((1000, 2))))
    state = one.steps[-1].state
    assert state is not None
    assert len(state.held) == 0
    assert [event.rows for event in one.events if event.kind == "garbled"] == [1000] * 3


def test_rows_that_share_a_stamp_stay_in_their_order() -> None:
    rows = rows_of(400)
    coarse = SensorRows(np.floor(rows.time_s), rows.values)
    one = walker(recipe_of(*CHANNELS))
    one.hear(part(coarse, slice(0, 233)), part(coarse, slice(233, 400)))
    assert_same_bits(one.said, by_stream(coarse))
