"""A serial port, played by a pseudo-terminal: rows come, half lines at the opening do not, and it may be unplugged."""

from __future__ import annotations

import os
import tty
from collections.abc import Iterator
from io import FileIO
from pathlib import Path

import pytest

from becalm.errors import UsageError
from becalm.live.address import Address
from becalm.live.protocols import AwayError
from becalm.live.sources.serial import SerialSource
from instruments import next_block


class Board:
    """What sits at the other end of the wire; the port is a link, so that it can be plugged in anew."""

    def __init__(self, port: Path) -> None:
        self.port = port
        self._end: FileIO | None = None
        self.plug_in()

    def plug_in(self) -> None:
        board, port = os.openpty()
        tty.setraw(port)
        self.port.symlink_to(os.ttyname(port))
        self._end, self._kept = FileIO(board, "r+"), FileIO(port, "r+")

    def says(self, line: bytes) -> None:
        assert self._end is not None
        self._end.write(line)

    def unplug(self) -> None:
        if self._end is not None:
            self._end.close()
            self._kept.close()
            self.port.unlink()
            self._end = None


@pytest.fixture
def board(tmp_path: Path) -> Iterator[Board]:
    one = Board(tmp_path / "ttyUSB0")
    yield one
    one.unplug()


@pytest.fixture
def source(board: Board) -> Iterator[SerialSource]:
    one = SerialSource(Address.parsed(f"serial:{board.port}?baud=115200"))
    yield one
    one.close()


def test_rows_come(board: Board, source: SerialSource) -> None:
    source.open("")
    assert source.read(0.0) is None
    board.says(b"time_ms,ax (g)\r\n10,1.5\r\n")
    block = next_block(source)
    while not len(block):
        block = next_block(source)
    assert (block.names, block.units) == (("ax (g)",), ("g",))
    assert block.time_s.tolist() == [0.01]
    board.says(b"20,")
    assert source.read(0.01) is None
    board.says(b"2.5\r\n")
    assert next_block(source).values.tolist() == [[2.5]]
    source.committed("")


def test_a_half_line_at_the_opening_is_no_loss(board: Board, source: SerialSource) -> None:
    source.open("")
    board.says(b"5,77\n1.0,2\n2.0,3\n")
    rows: list[list[float]] = []
    while len(rows) < 2:
        block = next_block(source)
        rows += block.values.tolist()
        assert not block.losses
    assert rows == [[1.0, 2.0], [2.0, 3.0]]


def test_an_unplugged_port_is_away_and_comes_back(board: Board, source: SerialSource) -> None:
    source.open("")
    board.says(b"a,b\n1,2\n3,")
    assert next_block(source).values.tolist() == [[1.0, 2.0]]
    board.unplug()
    with pytest.raises(AwayError, match="ttyUSB0 can no longer be read"):
        source.read(30.0)
    source.close()
    source.close()
    with pytest.raises(AwayError, match="cannot be opened"):
        source.open("")
    board.plug_in()
    source.open("")
    board.says(b"4\n5,6\n")
    block = next_block(source)
    assert block.values.tolist() == [[5.0, 6.0]]
    assert not block.losses


def test_noise_on_the_wire_is_counted(board: Board, source: SerialSource) -> None:
    source.open("")
    board.says(b"a,b\n1,2\n\xff\x00\xfe\n3,4\n")
    rows: list[list[float]] = []
    lost = 0
    while len(rows) < 2:
        block = next_block(source)
        rows += block.values.tolist()
        lost += sum(loss.rows or 0 for loss in block.losses)
    assert rows == [[1.0, 2.0], [3.0, 4.0]]
    assert lost == 1


def test_a_port_that_another_has_is_away(board: Board, source: SerialSource) -> None:
    source.open("")
    other = SerialSource(Address.parsed(f"serial:{board.port}"))
    with pytest.raises(AwayError, match="cannot be opened"):
        other.open("")


def test_a_closed_port_is_away(source: SerialSource) -> None:
    with pytest.raises(AwayError, match="is closed"):
        source.read(0.0)


def test_a_url_that_is_none_is_refused() -> None:
    with pytest.raises(UsageError, match="cannot be opened with these settings"):
        SerialSource(Address.parsed("serial:carrier-pigeon://x")).open("")
