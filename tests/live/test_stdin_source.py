"""Lines from a pipe: what came is given at once, nothing is waited for too long, and the end is the end."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from io import FileIO
from pathlib import Path

import pytest

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.protocols import EndOfStream
from becalm.live.sources.stdin import StdinSource


@pytest.fixture
def pipe() -> Iterator[tuple[StdinSource, FileIO]]:
    """Make a pipe: the source that reads it, and what writes into it."""
    reader, writer = os.pipe()
    with FileIO(writer, "w") as end:
        source = StdinSource(Address.parsed("stdin:"), reader)
        source.open("")
        yield source, end
    os.close(reader)


def test_rows_come_as_they_are_written(pipe: tuple[StdinSource, FileIO]) -> None:
    source, writer = pipe
    assert source.read(0.01) is None
    writer.write(b"time,a\n1,2\n2,")
    block = source.read(30.0)
    assert block is not None
    assert block.values.tolist() == [[2.0]]
    assert source.read(0.01) is None  # half a line
    writer.write(b"3\n")
    block = source.read(30.0)
    assert block is not None
    assert block.time_s.tolist() == [2.0]
    assert block.position == ""
    source.committed("")
    source.close()


def test_a_closed_pipe_is_the_end(pipe: tuple[StdinSource, FileIO]) -> None:
    source, writer = pipe
    writer.write(b"time,a\n1,2\n2,3")
    writer.close()
    first, last = source.read(30.0), source.read(30.0)
    assert first is not None
    assert first.values.tolist() == [[2.0]]
    assert last is not None
    assert [loss.rows for loss in last.losses] == [1]
    for _ in range(2):
        with pytest.raises(EndOfStream):
            source.read(0.0)


def test_a_row_is_waited_for(pipe: tuple[StdinSource, FileIO]) -> None:
    source, writer = pipe
    late = threading.Timer(0.05, writer.write, (b'{"a": 1}\n',))
    late.start()
    block = source.read(30.0)
    late.join()
    assert block is not None
    assert block.names == ("a",)


def test_a_line_that_never_ends_holds_nobody_up(pipe: tuple[StdinSource, FileIO]) -> None:
    source, writer = pipe
    stop = threading.Event()

    def pour() -> None:
        while not stop.is_set():
            writer.write(b"x" * 4096)

    thread = threading.Thread(target=pour)
    thread.start()
    try:
        block = source.read(0.05)
        assert block is None or not len(block)  # the loss of a long line
    finally:
        stop.set()
        while thread.is_alive():
            source.read(0.01)
    thread.join()


def test_what_cannot_be_read_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = os.open(tmp_path, os.O_RDONLY)
    try:
        source = StdinSource(Address.parsed("stdin:"), folder)
        source.open("")
        with pytest.raises(InputError, match="cannot be read"):
            source.read(30.0)
    finally:
        os.close(folder)
    monkeypatch.setattr(sys, "__stdin__", None)
    with pytest.raises(InputError, match="is closed"):
        StdinSource(Address.parsed("stdin:")).open("")


def test_an_address_makes_it() -> None:
    source = StdinSource(Address.parsed("stdin:?rate=50"))
    assert source.rate_hz == 50.0
    assert not source.replays
    with pytest.raises(UsageError, match="no option 'speed'"):
        StdinSource(Address.parsed("stdin:?speed=1"))
    with pytest.raises(UsageError, match="takes no name"):
        StdinSource(Address.parsed("stdin:file.csv"))
