"""One sensor from micro-batch to micro-batch: what a live stream tells, wherever they are cut."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.cleaning.pipeline import clean
from becalm.cleaning.recipes.recipe import Origin
from becalm.core.recording import Recording
from becalm.core.time.timebase import Timebase
from becalm.errors import ModelError, UsageError
from becalm.fleet.stream.blocks import SensorRows, UnreadableInput
from becalm.fleet.stream.plan import FIRST_ROWS, SensorPlan, StreamPlan
from becalm.fleet.stream.sensor import SensorStreamProcessor
from made import RATE_HZ, recipe_of
from streaming import (
    BEGINS_S,
    CHANNELS,
    RECIPE,
    ROWS,
    Shelf,
    Walker,
    assert_same_bits,
    by_stream,
    cut,
    lagged,
    part,
    rows_of,
    walker,
)


@given(cuts=st.lists(st.integers(0, ROWS), max_size=9), seed=st.integers(0, 50))
@settings(max_examples=30)
def test_cuts_change_no_bit(cuts: list[int], seed: int) -> None:
    rows, one = rows_of(ROWS, seed), walker()
    for batch in cut(rows, cuts):
        one.hear(batch)
    assert_same_bits(one.said, by_stream(rows))
    assert one.kinds() == ["gap", "gap"]


@given(cuts=st.lists(st.integers(0, ROWS), max_size=5))
@settings(max_examples=10)
def test_a_lag_changes_no_bit_either(cuts: list[int]) -> None:
    rows, one = rows_of(ROWS), walker(lagged(0.2))
    for batch in cut(rows, cuts):
        one.hear(batch)
    assert_same_bits(one.said, by_stream(rows, lagged(0.2)))


def test_it_is_the_causal_filter_of_a_file() -> None:
    rows = rows_of(ROWS)
    recording = Recording(rows.values, names=CHANNELS, units=("m", "m"), timebase=Timebase.from_stamps(rows.time_s))
    recipe = RECIPE.model_copy(update={"tuned_on": Origin(rate_hz=1 / recording.timebase.step_s)})
    one, filed = walker(recipe), clean(recording, recipe, causal=True)
    for batch in cut(rows, [100, 333, 700]):
        one.hear(batch)
    np.testing.assert_allclose(one.said.signal, filed.signal.samples, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(one.said.sigma, filed.sigma.samples, rtol=1e-12)
    np.testing.assert_array_equal(one.said.verdicts, np.column_stack([*filed.verdicts.values()]))


@given(st.data())
@settings(max_examples=20)
def test_the_order_within_a_micro_batch_does_not_matter(data: st.DataObject) -> None:
    rows, one = rows_of(300), walker()
    for batch in cut(rows, [150]):
        order = data.draw(st.permutations(range(150)))
        first = data.draw(st.integers(0, 150))
        one.hear(part(batch, order[:first]), part(batch, order[first:]))
    assert_same_bits(one.said, by_stream(rows))


@given(st.data())
@settings(max_examples=20)
def test_rows_late_by_less_than_the_lateness_are_put_in_order(data: st.DataObject) -> None:
    rows, one = rows_of(400), walker(lateness_s=0.5)
    came = np.argsort(rows.time_s + data.draw(st.sampled_from([0.0, 0.2, 0.4])) * np.random.default_rng(3).random(400))
    for batch in cut(part(rows, list(came)), data.draw(st.lists(st.integers(0, 400), max_size=9))):
        one.hear(batch)
    told = len(one.said.time_s)
    assert 400 - 70 < told < 400
    assert "late" not in one.kinds()
    assert_same_bits(one.said, by_stream(part(rows, slice(0, told))))


def test_a_wild_stamp_hurries_nobody_and_is_left_out() -> None:
    rows, one = rows_of(200), walker(lateness_s=0.5)
    wild = SensorRows(np.array([BEGINS_S + 1e9]), np.zeros((1, 2)))
    assert one.hear(part(rows, slice(0, 40)), wild).estimates is None
    one.hear(part(rows, slice(50, 70)))
    one.hear(part(rows, slice(40, 50)), part(rows, slice(70, 200)))
    assert [event.kind for event in one.events if event.kind != "gap"] == ["clock"]
    told = len(one.said.time_s)
    assert told > 100
    assert_same_bits(one.said, by_stream(part(rows, slice(0, told))))


def test_blocks_that_are_none_are_counted() -> None:
    one = walker()
    step = one.hear(rows_of(100)._replace(garbled=(UnreadableInput(3, "3 blocks."), UnreadableInput(None, "A file."))))
    assert [event for event in step.events if event.kind == "garbled"] == [
        ("garbled", 3, "3 blocks."),
        ("garbled", None, "A file."),
    ]


def test_rows_in_other_units_are_left_out_and_counted() -> None:
    rows, one = rows_of(300), walker()
    first, second, third = (one._replace(units=("m", "m")) for one in cut(rows, [120, 200]))
    one.hear(first, second._replace(units=("mm", "m")), SensorRows(np.empty(0), np.empty((0, 2)), ("g", "g")))
    one.hear(third)
    assert ("garbled", 80) in [(event.kind, event.rows) for event in one.events]
    assert_same_bits(one.said, by_stream(part(rows, list(np.r_[0:120, 200:300]))))


def test_a_channel_that_a_file_has_not_has_no_unit_to_differ_in() -> None:
    rows, one = rows_of(300), walker()
    without = part(rows, slice(100, 150))
    without.values[:, 1] = np.nan
    one.hear(part(rows, slice(0, 100))._replace(units=("m", "m")), without._replace(units=("m", "")))
    one.hear(part(rows, slice(150, 200))._replace(units=("m", "")))
    assert {event.kind for event in one.events} <= {"gap"}
    assert len(one.said.time_s) == 200


def test_units_that_are_not_the_recipe_s_are_refused() -> None:
    rows, one = rows_of(100), walker()
    (event,) = one.hear(rows._replace(units=("mm", "m"))).events
    assert (event.kind, event.rows) == ("refused", 100)
    assert "in 'm', the recording in 'mm'" in event.says


def test_rows_that_wait_go_under_the_channels_that_there_are_now() -> None:
    rows, one = rows_of(40), walker(recipe_of("b"))
    one.hear(part(rows, slice(0, 10)))
    one._walk = SensorStreamProcessor(one.plan, ("b", "c"))  # the stream was begun again, with others
    one.hear(SensorRows(rows.time_s[10:], rows.values[10:, [1, 0]]))
    np.testing.assert_array_equal(one.said.signal[:, 0], by_stream(rows).signal[:, 1])


def test_so_do_their_units() -> None:
    rows, one = rows_of(40)._replace(units=("m", "m")), walker(recipe_of("b"))
    one.hear(part(rows, slice(0, 10)))
    one._walk = SensorStreamProcessor(one.plan, ("b", "c", "a"))
    step = one.hear(SensorRows(rows.time_s[10:], rows.values[10:, [1, 0, 0]], ("m", "mm", "m")))
    assert {event.kind for event in step.events} == {"gap"}
    np.testing.assert_array_equal(one.said.signal[:, 0], by_stream(rows).signal[:, 1])


def test_a_file_of_nobody_that_cannot_be_read_is_one_event() -> None:
    one = Walker(SensorPlan(Shelf()), sensor="")
    step = one.hear(SensorRows(np.empty(0), np.empty((0, 2)), (), (UnreadableInput(None, "It is damaged."),)))
    assert [event.kind for event in step.events] == ["garbled"]
    assert step.state is None


def test_rows_of_nobody_are_left_out_and_counted() -> None:
    one = Walker(SensorPlan(Shelf()), sensor="")
    (event,) = one.hear(rows_of(50)).events
    assert (event.kind, event.rows) == ("refused", 50)
    assert "The rows have no sensor name" in event.says


def test_nothing_is_kept_of_a_name_that_nobody_has_a_recipe_for() -> None:
    one = walker(None, silent_s=60.0)
    step = one.hear(rows_of(50))
    assert (step.state, step.timer_ms) == (None, None)
    assert [event.kind for event in step.events] == ["refused"]


def test_a_sensor_waits_for_its_first_rows() -> None:
    rows, one = rows_of(100), walker()
    for k in range(FIRST_ROWS - 1):
        assert one.hear(part(rows, slice(k, k + 1))).estimates is None
    step = one.hear(part(rows, slice(FIRST_ROWS - 1, FIRST_ROWS)))
    assert step.estimates is not None
    assert len(step.estimates.time_s) == FIRST_ROWS


def test_a_micro_batch_that_is_done_again_tells_the_same() -> None:
    rows, one = rows_of(ROWS), walker(lateness_s=0.3)
    first, second = cut(rows, [500])
    one.hear(first)
    state = one.state
    steps, states = [], []
    for _ in range(2):
        one.state = state
        steps.append(one.hear(second))
        states.append(one.state)
    assert states[0] == states[1]
    assert steps[0].estimates is not None
    assert steps[1].estimates is not None
    assert steps[0].estimates.packed() == steps[1].estimates.packed()


def test_a_state_that_cannot_be_read_loses_no_row() -> None:
    """The stream ends before it has taken them: of a newer becalm's states all would be lost else."""
    rows, one = rows_of(300), walker(silent_s=1.0)
    one.hear(part(rows, slice(0, 100)))
    state = one.steps[-1].state
    assert state is not None
    assert state.stream is not None
    one.state = replace(state, stream=replace(state.stream, snapshot=state.stream.snapshot[:-9])).packed()
    with pytest.raises(ModelError, match="damaged"):
        one.hear(part(rows, slice(100, 300)))
    one.now_ms = 2000
    with pytest.raises(ModelError, match="damaged"):
        one.wake()


@pytest.mark.parametrize("how", [{"lateness_s": -1.0}, {"lateness_s": np.nan}, {"silent_s": 0.0}])
def test_times_that_are_none_are_refused(how: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=next(iter(how))):
        SensorPlan(Shelf(), **how)


@pytest.mark.parametrize("how", [{"every_s": -1.0}, {"every_s": 0.0}, {"partitions": 0}])
def test_a_plan_that_cannot_be_is_refused(how: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=next(iter(how))):
        StreamPlan("lake", "out", SensorPlan(Shelf(), silent_s=1.0), **how)


@pytest.mark.parametrize(("slower", "kinds"), [(1, set()), (2, {"rate"}), (0.5, {"rate"})])
def test_rows_at_another_rate_than_the_recipe_s_are_said(slower: float, kinds: set[str]) -> None:
    time_s = np.round((BEGINS_S + slower * np.arange(100) / RATE_HZ) * 1e6) / 1e6
    one = walker()
    one.hear(SensorRows(time_s[:60], np.ones((60, 2))))
    one.hear(SensorRows(time_s[60:], np.ones((40, 2))))
    assert set(one.kinds()) & {"rate"} == kinds
    assert one.kinds().count("rate") <= 1


def test_a_name_that_no_folder_can_have_is_refused() -> None:
    one = Walker(SensorPlan(Shelf()), sensor="ü" * 130)
    (event,) = one.hear(rows_of(50)).events
    assert (event.kind, event.rows, one.state) == ("refused", 50, None)
    assert "is too long for the name of a folder" in event.says
    assert one._walk.output_name("ü" * 130) == ""
    assert one._walk.output_name("ü" * 120) == "ü" * 120
