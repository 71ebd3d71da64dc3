"""A stream from end to end: what is told is what an uninterrupted stream tells, whatever happens on the way."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.arrays import Floats
from becalm.errors import InputError, RecipeError, UsageError
from becalm.live.block import Block, Checkpoint, Loss, LossKind, Output
from becalm.live.buffered_sink import BufferedSink
from becalm.live.protocols import AwayError, StorageFullError
from becalm.live.running.commit_thread import StreamSinks
from becalm.live.running.learning_buffer import Learner
from becalm.live.running.runner import Runner
from becalm.live.running.settings import Settings
from becalm.live.running.stream_start import StreamStarter
from becalm.live.watching.meter import Meter
from becalm.live.watching.watch import Watch
from stand_ins import ListSource, MemoryKeeper, MemorySink, blocks_of, drive, recipe_of

VALUES = drive(600)
EVERY_BLOCK = Settings(commit_s=0.0, patience_s=0.5)


def runner_of(source: ListSource, keeper: MemoryKeeper | None, recipe: Recipe | None = None, **more: Any) -> Runner:
    sinks = StreamSinks(keeper, tuple(BufferedSink(sink) for sink in more.pop("sinks", ())))
    told: dict[str, Any] = {"starter": StreamStarter(recipe, Learner(2.0)), "settings": EVERY_BLOCK, **more}
    return Runner(source=source, address="list:rows", sinks=sinks, watch=Watch(Meter()), **told)


def run(values: Floats = VALUES, sizes: int | list[int] = 50, **more: Any) -> MemoryKeeper:
    keeper = MemoryKeeper()
    runner_of(ListSource(lambda row: blocks_of(values, sizes, row)), keeper, recipe_of(), **more).run()
    return keeper


def assert_same(found: MemoryKeeper, wanted: MemoryKeeper) -> None:
    np.testing.assert_array_equal(found.rows, wanted.rows)
    np.testing.assert_array_equal(found.signal, wanted.signal)
    np.testing.assert_array_equal(found.sigma, wanted.sigma)


def test_all_rows_are_kept_once_and_in_order() -> None:
    keeper = run()
    np.testing.assert_array_equal(keeper.rows, np.arange(600))
    assert keeper.losses == []
    assert keeper.closed == 1
    np.testing.assert_array_equal(np.concatenate([one.values for one in keeper.outputs]), VALUES)


@settings(max_examples=15)
@given(st.lists(st.integers(1, 70), min_size=1, max_size=6))
def test_however_rows_come_the_bits_are_the_same(sizes: list[int]) -> None:
    assert_same(run(sizes=sizes), run())


@pytest.mark.parametrize("more", [{}, {"mode": "lagged", "lag_s": 0.07}])
@settings(max_examples=10)
@given(deaths=st.lists(st.integers(0, 12), min_size=1, max_size=4))
def test_a_stream_that_dies_again_and_again_tells_what_one_does_that_never_did(
    more: dict[str, Any], deaths: list[int]
) -> None:
    recipe = recipe_of(**more)
    whole, keeper = MemoryKeeper(), MemoryKeeper()
    runner_of(ListSource(lambda row: blocks_of(VALUES, 50, row)), whole, recipe).run()
    for death in deaths:
        _die_at(keeper, death + 1)
        with suppress(RuntimeError):  # of old age, where all was kept before
            runner_of(ListSource(lambda row: blocks_of(VALUES, 37, row)), keeper, recipe).run()
        del keeper.commit
    runner_of(ListSource(lambda row: blocks_of(VALUES, 41, row)), keeper, recipe).run()
    assert_same(keeper, whole)


def _die_at(keeper: MemoryKeeper, commit: int) -> None:
    """Have a keeper die at one of the next commits: of odd ones before they are kept, of even ones after."""
    left = [commit]

    def keep(outputs: list[Output], checkpoint: Checkpoint) -> None:
        left[0] -= 1
        if left[0] or commit % 2 == 0:
            MemoryKeeper.commit(keeper, outputs, checkpoint)
        if not left[0]:
            raise RuntimeError("died")

    keeper.commit = keep  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("trouble", "kept"),
    [(AwayError("gone"), False), (AwayError("gone"), True), (StorageFullError("no room"), False)],
)
def test_trouble_with_the_keeper_loses_nothing_and_doubles_nothing(trouble: BaseException, kept: bool) -> None:
    keeper = MemoryKeeper()
    keeper.trouble, keeper.keeps_before_trouble = [trouble], kept
    runner_of(ListSource(lambda row: blocks_of(VALUES, 50, row)), keeper, recipe_of()).run()
    assert_same(keeper, run())


def test_a_keeper_that_is_away_at_the_start_is_waited_for() -> None:
    keeper, left = MemoryKeeper(), [AwayError("not there yet"), AwayError("not there yet")]

    def last() -> None:
        if left:
            raise left.pop()

    keeper.last = last  # type: ignore[method-assign]
    runner_of(ListSource(lambda row: blocks_of(VALUES, 50, row)), keeper, recipe_of()).run()
    assert_same(keeper, run())


def test_a_source_that_goes_away_is_opened_again_where_it_was() -> None:
    source, keeper = ListSource(lambda row: blocks_of(VALUES, 50, row)), MemoryKeeper()
    source.trouble = [AwayError("not there yet")]
    runner_of(source, keeper, recipe_of()).run()
    assert source.opened == ["", ""]
    assert_same(keeper, run())
    assert [kind for kind, _ in keeper.losses] == ["away", "away"]


def test_what_is_kept_is_acknowledged_and_nothing_else() -> None:
    source, keeper = ListSource(lambda row: blocks_of(VALUES, 50, row)), MemoryKeeper()
    runner_of(source, keeper, recipe_of()).run()
    assert source.acknowledged[-1] == '{"row": 600}'
    assert len(source.acknowledged) == len(set(source.acknowledged))


def test_sinks_get_every_row_before_it_is_kept() -> None:
    sink, keeper = MemorySink(), MemoryKeeper()
    sink.trouble_writing = [AwayError("gone")]
    sink.trouble_flushing = [AwayError("gone")]
    source = ListSource(lambda row: blocks_of(VALUES, 50, row))
    runner_of(source, keeper, recipe_of(), sinks=[sink]).run()
    np.testing.assert_array_equal(np.concatenate([one.signal for one in sink.got]), keeper.signal)


def test_a_source_that_cannot_go_back_has_its_gap_recorded() -> None:
    keeper = MemoryKeeper()
    first, second = VALUES[:300], VALUES
    runner_of(ListSource(lambda _: blocks_of(first, 50), replays=False), keeper, recipe_of()).run()
    runner_of(ListSource(lambda _: blocks_of(second, 50, 450), replays=False), keeper, recipe_of()).run()
    np.testing.assert_array_equal(keeper.rows, np.arange(450))
    assert ("gap", None) in keeper.losses
    assert ("gap", 150) in keeper.losses
    assert (keeper.sigma[300] > 1.5 * keeper.sigma[299]).all()


def test_a_kept_stream_takes_no_other_source() -> None:
    keeper = run()
    assert keeper.checkpoint is not None
    keeper.checkpoint = replace(keeper.checkpoint, source="udp:9000")
    with pytest.raises(UsageError, match="another place"):
        runner_of(ListSource(lambda _: []), keeper, recipe_of()).run()


def test_without_a_recipe_it_learns_one_and_loses_no_row() -> None:
    learned: list[Recipe] = []
    keeper = MemoryKeeper()
    runner_of(
        ListSource(lambda row: blocks_of(VALUES, 50, row)),
        keeper,
        starter=StreamStarter(None, Learner(2.0), learned.append),
    ).run()
    assert [channel.name for channel in learned[0].channel] == ["ax", "ay"]
    assert learned[0].mode == "causal"
    np.testing.assert_array_equal(keeper.rows, np.arange(600))
    again = MemoryKeeper()
    runner_of(ListSource(lambda row: blocks_of(VALUES, 50, row)), again, learned[0]).run()
    assert_same(keeper, again)


def test_too_few_rows_to_learn_from_are_told() -> None:
    with pytest.raises(InputError, match="needs 64"):
        runner_of(ListSource(lambda row: blocks_of(VALUES[:10], 5, row)), MemoryKeeper()).run()


def test_late_repeated_and_lost_rows_are_counted() -> None:
    blocks = blocks_of(VALUES[:100], 10)
    late = replace(blocks[4], time_s=blocks[4].time_s - 0.2)
    told = Loss(LossKind.GARBLED, 3, "3 lines could not be read.")
    given = [*blocks[:3], blocks[3], late, replace(blocks[6], losses=(told,)), *blocks[7:]]
    keeper = MemoryKeeper()
    runner_of(ListSource(lambda _: given), keeper, recipe_of()).run()
    assert len(keeper.rows) == 80 + 3  # eight stamps that ascend are a clock that went back
    counted = dict(keeper.losses)
    assert counted["late"] == 7
    assert counted["garbled"] == 3


def test_rows_that_come_twice_are_left_out_wherever_blocks_are_cut() -> None:
    whole = blocks_of(VALUES[:60], 60)[0]
    times, order = whole.time_s, np.repeat(np.arange(60), np.where(np.arange(60) % 7 == 0, 2, 1))
    for size in (1, 9, 100):
        cuts = np.split(order, range(size, len(order), size))
        given = [replace(whole, time_s=times[cut], values=VALUES[cut]) for cut in cuts]
        keeper = MemoryKeeper()
        runner_of(ListSource(lambda _, given=given: list(given)), keeper, recipe_of()).run()  # type: ignore[misc]
        assert len(keeper.rows) == 60
        assert sum(rows or 0 for kind, rows in keeper.losses if kind == "repeated") == 9


def test_a_stop_keeps_what_was_read() -> None:
    keeper = MemoryKeeper()
    source = ListSource(lambda row: blocks_of(VALUES, 50, row), ends=False)
    runner = runner_of(source, keeper, recipe_of(), settings=Settings(commit_s=1000.0))
    thread = threading.Thread(target=runner.run)
    thread.start()
    _until(lambda: runner.rows == 600)
    assert keeper.outputs == []
    runner.stop()
    thread.join(30)
    np.testing.assert_array_equal(keeper.rows, np.arange(600))


def test_a_stop_gives_the_delayed_rows_where_no_checkpoint_holds_them() -> None:
    sink = MemorySink()
    source = ListSource(lambda row: blocks_of(VALUES, 50, row), ends=False)
    runner = runner_of(source, None, recipe_of(mode="lagged", lag_s=0.07), sinks=[sink])
    thread = threading.Thread(target=runner.run)
    thread.start()
    _until(lambda: runner.rows == 593)
    runner.stop()
    thread.join(30)
    assert sum(map(len, sink.got)) == 600


@pytest.mark.parametrize("learner", [Learner(2.0, lag_s=0.5), Learner(2.0, channels=("ay",))])
def test_a_kept_stream_takes_no_other_lag_or_channels(learner: Learner) -> None:
    source = ListSource(lambda row: blocks_of(VALUES, 50, row))
    with pytest.raises(UsageError, match="has no lag and cleans ax, ay; --lag and --channels cannot change that"):
        runner_of(source, run(), starter=StreamStarter(None, learner)).run()


def test_a_loss_is_no_sign_that_a_silent_source_is_back() -> None:
    runner = runner_of(ListSource(lambda _: []), None)
    runner.watch = Watch(Meter(), None, -1.0)
    runner.watch.record_iteration(False)
    assert runner.watch.meter.status()["state"] == "silent"
    runner._queue.report(Loss(LossKind.AWAY, None, "Gone."))
    assert runner._next() is not None
    assert runner.watch.meter.status()["state"] == "silent"


def test_a_missing_row_explains_no_longer_gap_than_its_own() -> None:
    (block,) = blocks_of(VALUES[:200], 200)
    stamps = block.time_s + np.where(np.arange(200) >= 50, 0.01, 0.0) + np.where(np.arange(200) >= 100, 3600.0, 0.0)
    missing = Loss(LossKind.MISSING, 1, "One row.")
    keeper = MemoryKeeper()
    source = ListSource(lambda _: [replace(block, time_s=stamps, losses=(missing,))])
    runner_of(source, keeper, recipe_of()).run()
    assert keeper.losses == [("missing", 1), ("gap", 360_000)]


def test_a_full_disk_at_the_end_is_told_after_a_while() -> None:
    keeper = MemoryKeeper()
    keeper.trouble = [StorageFullError("no room")] * 1000
    with pytest.raises(StorageFullError, match="no room"):
        runner_of(ListSource(lambda row: blocks_of(VALUES, 300, row)), keeper, recipe_of()).run()
    assert keeper.outputs == []


def test_another_recipe_goes_on_without_a_jump() -> None:
    keeper = MemoryKeeper()
    runner_of(ListSource(lambda row: blocks_of(VALUES[:300], 50, row)), keeper, recipe_of()).run()
    before = keeper.signal[-1]
    quieter = tuple(one.model_copy(update={"process_noise_density": 0.05}) for one in recipe_of().channel)
    recipe = recipe_of().model_copy(update={"channel": quieter})
    runner_of(ListSource(lambda row: blocks_of(VALUES, 50, row)), keeper, recipe).run()
    assert (np.abs(keeper.signal[300] - before) < 0.05).all()
    assert keeper.checkpoint is not None
    assert Recipe.from_toml(keeper.checkpoint.recipe) == recipe


def test_a_recipe_that_cannot_be_is_refused_and_the_stream_goes_on() -> None:
    keeper = MemoryKeeper()
    runner = runner_of(ListSource(lambda row: blocks_of(VALUES, 50, row)), keeper, recipe_of())
    runner.retune(lambda: recipe_of(["ax", "gz"]))
    runner.run()
    assert_same(keeper, run())


def test_a_recipe_for_other_channels_is_refused() -> None:
    with pytest.raises(RecipeError, match="gz"):
        runner_of(ListSource(lambda row: blocks_of(VALUES, 50, row)), MemoryKeeper(), recipe_of(["ax", "gz"])).run()


@pytest.mark.parametrize("learned", [False, True])
def test_a_failing_reader_is_told_once_all_is_kept(learned: bool) -> None:
    keeper = MemoryKeeper()
    with pytest.raises(InputError, match="wire broke"):
        runner_of(_breaking(VALUES, 50), keeper, None if learned else recipe_of()).run()
    np.testing.assert_array_equal(keeper.rows, np.arange(600))


def test_a_failing_reader_is_told_where_too_little_came_to_learn_from() -> None:
    with pytest.raises(InputError, match="wire broke"):
        runner_of(_breaking(VALUES[:3], 3), MemoryKeeper(), None).run()


def _breaking(values: Floats, size: int) -> ListSource:
    """Return a source that fails once all is read."""
    source = ListSource(lambda row: blocks_of(values, size, row))
    made = source.read

    def read(timeout_s: float) -> Block | None:
        if not source._blocks:
            raise InputError("The wire broke.")
        return made(timeout_s)

    source.read = read  # type: ignore[method-assign]
    return source


def _until(true: Callable[[], bool]) -> None:
    waiting = threading.Event()
    for _ in range(3000):
        if true():
            return
        waiting.wait(0.01)
    raise AssertionError("It never came so far.")
