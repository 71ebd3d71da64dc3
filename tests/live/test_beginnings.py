"""What comes before a stream has filters: nothing of it is lost without a word, and learning ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from becalm.cleaning.recipes.recipe import Origin, Recipe
from becalm.core.arrays import Floats
from becalm.errors import BecalmError, InputError
from becalm.live.block import Block, Loss, LossKind
from becalm.live.running.commit_thread import StreamSinks
from becalm.live.running.learning_buffer import Learner, LearningBuffer
from becalm.live.running.runner import Runner
from becalm.live.running.stream_start import StreamStarter
from becalm.live.watching.meter import Meter
from becalm.live.watching.watch import Watch
from stand_ins import ListSource, MemoryKeeper, blocks_of, drive, recipe_of

VALUES = drive(600)


def runner_of(source: ListSource, keeper: MemoryKeeper, recipe: Recipe | None = None) -> Runner:
    watch = Watch(Meter())
    return Runner(
        source=source,
        address="list:rows",
        sinks=StreamSinks(keeper, ()),
        watch=watch,
        starter=StreamStarter(recipe, Learner(2.0)),
    )


def test_what_is_lost_before_any_row_is_told_though_no_row_ever_comes() -> None:
    lost = Loss(LossKind.GARBLED, 7, "Noise.")
    for recipe in (recipe_of(), None):
        runner = runner_of(ListSource(lambda _: [Block.of_losses(lost)]), MemoryKeeper(), recipe)
        runner.run()
        status = runner.watch.meter.status()
        assert status["losses"]["garbled"]["rows"] == 7
        assert status["state"] == "ended"


def test_what_is_lost_before_the_first_row_is_kept_and_counted_once() -> None:
    lost, keeper = Loss(LossKind.GARBLED, 7, "Noise."), MemoryKeeper()
    source = ListSource(lambda row: [Block.of_losses(lost), *blocks_of(VALUES, 50, row)])
    runner = runner_of(source, keeper, recipe_of())
    runner.run()
    assert keeper.losses == [("garbled", 7)]
    assert runner.watch.meter.status()["losses"]["garbled"]["rows"] == 7
    np.testing.assert_array_equal(keeper.rows, np.arange(600))


def test_what_is_lost_among_too_few_rows_to_learn_from_is_told() -> None:
    lost = Loss(LossKind.GARBLED, 7, "Noise.")
    source = ListSource(lambda row: [replace(blocks_of(VALUES[:9], 9)[0], losses=(lost,))])
    runner = runner_of(source, MemoryKeeper())
    with pytest.raises(InputError, match="Only 9 rows arrived"):
        runner.run()
    assert runner.watch.meter.status()["losses"]["garbled"]["rows"] == 7


def test_stamps_that_tell_no_rate_are_refused_by_what_a_source_may_be_told() -> None:
    source = ListSource(lambda _: [replace(one, time_s=np.full(50, 5.0)) for one in blocks_of(VALUES, 50)])
    with pytest.raises(InputError, match=r"\?time=.*\?rate=HZ") as refused:
        runner_of(source, MemoryKeeper()).run()
    assert "--" not in str(refused.value)


def early_of(stamps: list[Floats], arrivals: list[float]) -> LearningBuffer:
    early = LearningBuffer()
    for time_s, arrived_s in zip(stamps, arrivals, strict=True):
        early.add(Block(("ax",), ("",), time_s, np.zeros((len(time_s), 1)), arrived_s=arrived_s))
    return early


def test_a_clock_that_leaps_ends_no_learning() -> None:
    first, leap = np.arange(100) / 100, np.array([1e9, np.nan, 1e300, 1.0])
    assert not Learner(2.0).is_enough(early_of([first, leap], [1.0, 1.01]), None)
    assert Learner(2.0).is_enough(early_of([first, leap, first + 1, first + 2], [1.0, 1.01, 2.0, 3.0]), None)


def test_learning_does_not_wait_forever_for_stamps_that_stand_still() -> None:
    stuck = [np.full(50, 5.0)] * 3
    assert not Learner(2.0).is_enough(early_of(stuck, [0.0, 1.0, 2.5]), None)
    assert Learner(2.0).is_enough(early_of(stuck, [0.0, 1.0, 15.0]), None)


@pytest.mark.parametrize("stamp_s", [1e300, 1e17])
def test_a_first_stamp_beyond_all_counting_after_a_restart_is_a_gap_of_unknown_rows(stamp_s: float) -> None:
    keeper = MemoryKeeper()
    runner_of(ListSource(lambda _: blocks_of(VALUES, 50)), keeper, recipe_of()).run()
    far = replace(blocks_of(VALUES[:1], 1)[0], time_s=np.array([stamp_s]))
    runner_of(ListSource(lambda _: [far]), keeper, recipe_of()).run()
    assert keeper.losses == [("gap", None)]


@pytest.mark.parametrize("rate_hz", [300.0, 1.5])
def test_the_resolution_of_stamps_is_that_of_the_first_rows_however_cut(rate_hz: float) -> None:
    stamps = np.round(np.arange(600) / rate_hz, 3) + 1.7e9
    recipe, kept = recipe_of(tuned_on=Origin(rate_hz=rate_hz)), []
    for first in (1, 5, 19, 20, 500):
        cuts = [slice(0, first), slice(first, 600)]
        blocks = [Block(("ax", "ay"), ("", ""), stamps[cut], VALUES[cut]) for cut in cuts]
        blocks[1] = replace(blocks[1], losses=(Loss(LossKind.GARBLED, 1, "Noise."),))  # so that they are not joined
        kept.append(MemoryKeeper())
        runner_of(ListSource(lambda _, blocks=blocks: list(blocks)), kept[-1], recipe).run()  # type: ignore[misc]
        np.testing.assert_array_equal(kept[-1].sigma, kept[0].sigma)
        np.testing.assert_array_equal(kept[-1].signal, kept[0].signal)


@pytest.mark.parametrize(("rate_hz", "first"), [(100.0, 20), (1 / 60, 1)])
def test_a_slow_stream_does_not_wait_for_the_resolution_of_its_stamps(rate_hz: float, first: int) -> None:
    start = StreamStarter(recipe_of(tuned_on=Origin(rate_hz=rate_hz)), Learner(2.0))
    for rows in range(1, 21):
        early = early_of([np.arange(rows) / rate_hz], [1.0])
        assert (start._stream_of(early, None, ended=False) is not None) == (rows >= first)


def test_few_rows_are_all_kept() -> None:
    keeper = MemoryKeeper()
    runner_of(ListSource(lambda _: blocks_of(VALUES[:7], 3)), keeper, recipe_of()).run()
    np.testing.assert_array_equal(keeper.rows, np.arange(7))


def named(names: tuple[str, ...], units: tuple[str, ...]) -> ListSource:
    return ListSource(lambda row: [replace(one, names=names, units=units) for one in blocks_of(VALUES, 50, row)])


def test_a_channel_named_with_its_unit_in_a_file_is_found_in_a_message() -> None:
    recipe, keeper = recipe_of(("ax (g)", "ay (g)")), MemoryKeeper()
    units = tuple(one.model_copy(update={"unit": "g"}) for one in recipe.channel)
    recipe = recipe.model_copy(update={"channel": units})
    runner_of(named(("ay", "ax"), ("g", "g")), keeper, recipe).run()
    assert keeper.heads[0].names == ("ax (g)", "ay (g)")
    np.testing.assert_array_equal(np.concatenate([one.values for one in keeper.outputs]), VALUES[:, ::-1])
    with pytest.raises(BecalmError, match="km"):
        runner_of(named(("ay", "ax"), ("g", "km")), MemoryKeeper(), recipe).run()
