"""A sink beside the keeper: what it could not take waits, and comes to it once, in order."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.live.block import Head, Output
from becalm.live.buffered_sink import BufferedSink
from becalm.live.protocols import AwayError
from stand_ins import MemorySink

HEAD = Head(("ax",), ("",), 100.0, "")


def output(row: int) -> Output:
    one = np.full((1, 1), float(row))
    return Output(row, np.array([row / 100]), one, one, one, np.zeros((1, 1), np.int8))


def test_rows_wait_for_a_sink_that_went_away() -> None:
    sink = MemorySink()
    outlet = BufferedSink(sink)
    outlet.open(HEAD)
    sink.trouble_writing = [AwayError("gone")]
    for row in range(4):
        outlet.write(output(row))
    assert sink.got == []
    outlet.flush()
    assert [one.first_row for one in sink.got] == [0, 1, 2, 3]
    assert (sink.opens, sink.flushed) == (2, 1)


def test_rows_written_after_a_flush_failed_do_not_overtake_those_that_wait() -> None:
    sink = MemorySink()
    outlet = BufferedSink(sink)
    outlet.open(HEAD)
    sink.trouble_writing = [AwayError("gone"), AwayError("gone again")]
    outlet.write(output(0))
    with pytest.raises(AwayError):
        outlet.flush()
    outlet.write(output(1))
    outlet.flush()
    assert [one.first_row for one in sink.got] == [0, 1]


def test_a_flush_that_fails_is_told_and_tried_again() -> None:
    sink = MemorySink()
    outlet = BufferedSink(sink)
    outlet.open(HEAD)
    outlet.write(output(0))
    sink.trouble_flushing = [AwayError("gone")]
    with pytest.raises(AwayError):
        outlet.flush()
    outlet.mark_away()
    outlet.write(output(1))
    outlet.flush()
    assert [one.first_row for one in sink.got] == [0, 1]
