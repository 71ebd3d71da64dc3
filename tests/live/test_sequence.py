from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from batches import batch, told
from becalm.core.arrays import Floats
from becalm.live.block import Loss, LossKind
from becalm.live.messages.sequence import WAIT_S, Sequence


def rows_of(losses: tuple[Loss, ...], kind: LossKind) -> int:
    return sum(loss.rows or 0 for loss in losses if loss.kind is kind)


@dataclass
class Journey:
    """Messages of one run, and how they came."""

    lengths: list[int]
    order: list[int]  # which message came, in order; those that did not come are not in it, others may be twice

    def starts(self) -> list[int]:
        return [0, *np.cumsum(self.lengths).tolist()]

    def run(self, sequence: Sequence) -> tuple[Floats, tuple[Loss, ...]]:
        starts = self.starts()
        for message in self.order:
            sequence.take(batch(starts[message], self.lengths[message]), 0.0)
        sequence.release_all()
        return told(sequence), sequence.losses()


@st.composite
def journeys(draw: st.DrawFn) -> Journey:
    """Anything: lost, doubled, and shuffled as one likes."""
    lengths = draw(st.lists(st.integers(1, 5), min_size=1, max_size=12))
    order = draw(st.lists(st.integers(0, len(lengths) - 1), max_size=30))
    return Journey(lengths, order)


@st.composite
def usual_journeys(draw: st.DrawFn) -> Journey:
    """Some lost, some doubled at once, and each other one overtaken by at most two that were sent later."""
    lengths = draw(st.lists(st.integers(1, 5), min_size=1, max_size=40))
    kept = [message for message in range(len(lengths)) if draw(st.integers(0, 4))]
    delays = {message: draw(st.integers(0, 2)) + 0.5 * (message / 100) for message in kept}
    order = sorted(kept, key=lambda message: message + delays[message])
    return Journey(lengths, [message for message in order for _ in range(1 + draw(st.booleans()))])


@given(journeys(), st.integers(0, 4))
def test_each_row_is_told_once_or_missing_whatever_comes(journey: Journey, reorder: int) -> None:
    numbers, losses = journey.run(Sequence(reorder))
    assert (np.diff(numbers) > 0).all()  # in order, none twice
    if len(numbers):
        assert rows_of(losses, LossKind.MISSING) == numbers[-1] + 1 - numbers[0] - len(numbers)
    came = sum(journey.lengths[message] for message in journey.order)
    left_out = rows_of(losses, LossKind.LATE) + rows_of(losses, LossKind.REPEATED)
    assert len(numbers) + left_out == came


@given(usual_journeys())
def test_within_the_window_all_that_came_is_told_and_exactly_the_lost_are_missing(journey: Journey) -> None:
    numbers, losses = journey.run(Sequence(2))
    starts = journey.starts()
    came = sorted(set(journey.order))
    expected = [row for message in came for row in range(starts[message], starts[message + 1])]
    np.testing.assert_array_equal(numbers, expected)
    span = expected[-1] + 1 - expected[0] if expected else 0
    assert rows_of(losses, LossKind.MISSING) == span - len(expected)
    assert rows_of(losses, LossKind.LATE) == 0
    assert rows_of(losses, LossKind.REPEATED) == sum(journey.lengths[message] for message in journey.order) - len(
        expected
    )


@given(usual_journeys(), st.integers(0, 40))
def test_a_gap_across_a_restart_is_seen(journey: Journey, cut: int) -> None:
    whole, _ = journey.run(Sequence(2))
    before, after = Sequence(2), Sequence(2)
    head, lost_head = Journey(journey.lengths, journey.order[:cut]).run(before)
    after.resume(json.loads(json.dumps(before.state)))
    tail, lost_tail = Journey(journey.lengths, journey.order[cut:]).run(after)
    numbers = np.concatenate([head, tail])
    assert (np.diff(numbers) > 0).all()
    if len(numbers):
        missing = rows_of(lost_head, LossKind.MISSING) + rows_of(lost_tail, LossKind.MISSING)
        assert missing == numbers[-1] + 1 - numbers[0] - len(numbers)
    assert set(numbers) <= set(whole)


def test_what_came_ahead_waits_for_twenty_milliseconds() -> None:
    sequence = Sequence(8)
    sequence.take(batch(0, 10), 1.0)
    sequence.take(batch(20, 10), 1.0)
    sequence.release_due(1.0 + WAIT_S / 2)
    assert len(told(sequence)) == 10
    assert sequence.wait_s(1.0) == pytest.approx(WAIT_S)
    sequence.release_due(1.0 + WAIT_S * 1.01)
    np.testing.assert_array_equal(told(sequence), np.arange(20, 30))
    (loss,) = sequence.losses()
    assert (loss.kind, loss.rows, loss.says) == (LossKind.MISSING, 10, "Rows 10 to 19 did not arrive.")


def test_what_comes_after_it_was_given_up_is_late_and_not_repeated() -> None:
    sequence = Sequence()
    for seq in (0, 20, 10, 20):
        sequence.take(batch(seq, 10), 0.0)
    losses = sequence.losses()
    assert [(loss.kind, loss.rows) for loss in losses] == [
        (LossKind.MISSING, 10),
        (LossKind.LATE, 10),
        (LossKind.REPEATED, 10),
    ]


def test_many_losses_are_one_record_with_few_words() -> None:
    sequence = Sequence()
    for seq in range(0, 2000, 20):
        sequence.take(batch(seq, 10), 0.0)
    (loss,) = sequence.losses()
    assert loss.rows == 990
    assert loss.says == "Rows 10 to 19, 30 to 39, 50 to 59, 70 to 79 and 95 more spans did not arrive."
    assert sequence.losses() == ()


def test_overlapping_parts_are_trimmed() -> None:
    sequence = Sequence()
    sequence.take(batch(0, 10), 0.0)
    sequence.take(batch(5, 10), 0.0)
    np.testing.assert_array_equal(told(sequence), np.arange(15))
    assert rows_of(sequence.losses(), LossKind.REPEATED) == 5


@pytest.mark.parametrize("first", [0, 30])
def test_a_sender_that_begins_anew_with_newer_stamps_is_heard_at_once(first: int) -> None:
    sequence = Sequence(8)
    sequence.take(batch(0, 50), 0.0)
    sequence.take(batch(60, 10), 0.0)  # waits, and is of the old run
    sequence.take(batch(first, 10, began_s=1e6), 0.0)
    np.testing.assert_array_equal(told(sequence), [*range(50), *range(60, 70), *range(first, first + 10)])
    losses = sequence.losses()
    assert {loss.kind for loss in losses} == {LossKind.GAP, LossKind.MISSING}
    assert f"restarted at row {first}" in next(loss.says for loss in losses if loss.kind is LossKind.GAP)


@pytest.mark.parametrize("began_s", [None, -1e6])
def test_a_sender_that_begins_anew_without_newer_stamps_is_heard_after_a_second(began_s: float | None) -> None:
    sequence = Sequence(8)
    sequence.take(batch(0, 1000, began_s=None if began_s is None else 0.0), 0.0)
    assert len(told(sequence)) == 1000
    numbers: list[Floats] = []
    losses: list[Loss] = []
    for tenth in range(20):
        sequence.take(batch(tenth * 10, 10, began_s, arrived_s=tenth / 10), 0.0)
        numbers.append(told(sequence))
        losses += sequence.losses()
        state = json.loads(json.dumps(sequence.state))
        sequence = Sequence(8)
        sequence.resume(state)  # a restart in between changes nothing
    np.testing.assert_array_equal(np.concatenate(numbers), np.arange(100, 200))
    assert rows_of(tuple(losses), LossKind.REPEATED) == 100
    assert any(loss.kind is LossKind.GAP for loss in losses)


def test_a_broker_that_sends_again_what_was_told_begins_no_run() -> None:
    sequence = Sequence()
    for seq in (*range(0, 1000, 10), *range(500, 1000, 10), 1000):
        sequence.take(batch(seq, 10, None, arrived_s=seq / 1e4), 0.0)
    np.testing.assert_array_equal(told(sequence), np.arange(1010))


def test_a_number_far_ahead_does_not_end_the_stream() -> None:
    sequence = Sequence()
    sequence.take(batch(0, 10), 0.0)
    sequence.take(batch(10**15, 1), 0.0)
    for seq in range(10, 300, 10):
        sequence.take(batch(seq, 10, arrived_s=seq / 100), 0.0)
    told_rows = told(sequence)
    assert told_rows[-1] == 299
    assert rows_of(sequence.losses(), LossKind.MISSING) == 10**15 - 10


def test_numbers_tell_the_time_of_rows_without_stamps() -> None:
    sequence = Sequence(rate_hz=100.0)
    sequence.take(batch(7, 3, None, arrived_s=1000.0), 0.0)
    resumed = Sequence(rate_hz=100.0)
    resumed.resume(json.loads(json.dumps(sequence.state)))
    resumed.take(batch(20, 2, None, arrived_s=1234.5), 0.0)
    stamps = [ready.time_s for ready in (*sequence.ready(), *resumed.ready())]
    np.testing.assert_allclose(
        np.concatenate([s for s in stamps if s is not None]), 1000 + np.array([0, 1, 2, 13, 14]) / 100
    )
