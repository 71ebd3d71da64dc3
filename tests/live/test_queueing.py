"""The queue between wire and filters: bounded, in order, and every dropped row is counted."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest

from becalm.live.block import Block, Loss, LossKind
from becalm.live.running.queueing import BlockQueue
from stand_ins import blocks_of, drive

STOP = threading.Event()


def rows(block: Block | None) -> list[float]:
    assert block is not None
    return [round(float(t) * 100) for t in block.time_s]


def test_blocks_come_in_order_and_losses_in_their_place() -> None:
    queue = BlockQueue(4, "block")
    first, second = blocks_of(drive(4), 2)
    queue.put(first, STOP)
    queue.report(Loss(LossKind.AWAY, None, "Gone."))
    queue.put(second, STOP)
    queue.end()
    assert rows(queue.get(1)) == [0, 1]
    between = queue.get(1)
    assert between is not None
    assert [loss.says for loss in between.losses] == ["Gone."]
    assert not queue.ended
    assert rows(queue.get(1)) == [2, 3]
    assert queue.ended
    assert queue.get(0.0) is None


def test_a_full_queue_drops_the_oldest_and_counts_them() -> None:
    queue = BlockQueue(2, "drop-oldest")
    for block in blocks_of(drive(10), 2):
        queue.put(block, STOP)
    kept = queue.get(1)
    assert rows(kept) == [6, 7]
    assert kept is not None
    assert [(loss.kind, loss.rows) for loss in kept.losses] == [(LossKind.DROPPED, 6)]
    after = queue.get(1)
    assert rows(after) == [8, 9]
    assert after is not None
    assert after.losses == ()


def test_losses_of_a_dropped_block_without_rows_are_not_lost() -> None:
    queue = BlockQueue(1, "drop-oldest")
    queue.report(Loss(LossKind.AWAY, None, "Gone."))
    queue.put(blocks_of(drive(2), 2)[0], STOP)
    came = queue.get(1)
    assert came is not None
    assert [loss.kind for loss in came.losses] == [LossKind.AWAY]


def test_time_goes_on_over_rows_that_were_dropped() -> None:
    queue = BlockQueue(1, "drop-oldest")
    first, second = blocks_of(drive(4), 2, elapsed=True)
    queue.put(first, STOP)
    queue.report(Loss(LossKind.AWAY, None, "Gone."))
    queue.put(second, STOP)
    between, later = queue.get(1), queue.get(1)
    assert between is not None
    assert [loss.kind for loss in between.losses] == [LossKind.DROPPED, LossKind.AWAY]
    assert later is not None
    assert later.elapsed is not None
    assert later.elapsed.tolist() == [2.0, 1.0]


def test_a_full_queue_holds_its_reader_up() -> None:
    queue, done = BlockQueue(1, "block"), threading.Event()
    first, second = blocks_of(drive(4), 2)
    queue.put(first, STOP)

    def put() -> None:
        queue.put(second, STOP)
        done.set()

    thread = threading.Thread(target=put)
    thread.start()
    assert not done.wait(0.3)
    assert rows(queue.get(1)) == [0, 1]
    assert done.wait(30)
    thread.join()
    assert rows(queue.get(1)) == [2, 3]


def test_a_failure_is_raised_once_all_is_taken() -> None:
    queue = BlockQueue(4, "block")
    queue.put(blocks_of(drive(2), 2)[0], STOP)
    queue.end(ValueError("broken"))
    assert not queue.ended
    queue.get(1)
    with pytest.raises(ValueError, match="broken"):
        _ = queue.ended


@pytest.mark.parametrize("clocked", [True, False])
def test_blocks_that_wait_are_joined_until_there_are_enough(clocked: bool) -> None:
    queue, loss = BlockQueue(10, "block"), Loss(LossKind.AWAY, None, "Gone.")
    cut = blocks_of(drive(16), 2, elapsed=clocked)
    blocks = [replace(block, position=f"{k}", arrived_s=float(k)) for k, block in enumerate(cut)]
    blocks[5] = replace(blocks[5], losses=(loss,))
    blocks[7] = replace(blocks[7], elapsed=None if clocked else np.ones(2))
    for block in blocks:
        queue.put(block, STOP)
    queue.end()
    got = []
    while not queue.ended:
        got.append(queue.get(1, 5))
    assert [rows(block) for block in got] == [[0, 1, 2, 3, 4, 5], [6, 7, 8, 9], [10, 11, 12, 13], [14, 15]]
    told = [(block.position, block.arrived_s, block.losses) for block in got if block is not None]
    assert told == [("2", 0.0, ()), ("4", 3.0, ()), ("6", 5.0, (loss,)), ("7", 7.0, ())]
    whole = np.concatenate([block.values for block in got if block is not None])
    np.testing.assert_array_equal(whole, np.concatenate([block.values for block in blocks]))
    assert [None if block is None or block.elapsed is None else len(block.elapsed) for block in got] == (
        [6, 4, 4, None] if clocked else [None, None, None, 2]
    )
