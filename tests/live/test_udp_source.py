from __future__ import annotations

import json
import socket
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Block, LossKind
from becalm.live.protocols import EndOfStream
from becalm.live.sources.udp import UdpSource
from datagrams import ROWS, bad_journey, heard, losses, message, rows, wire


def counted(blocks: list[Block], kind: LossKind) -> int:
    return sum(loss.rows or 0 for loss in losses(blocks) if loss.kind is kind)


@pytest.mark.parametrize("options", ["", "?gather=20ms", "?gather=5ms&reorder=3"])
@pytest.mark.parametrize("form", ["arrow", "json"])
def test_every_row_once_and_in_order_with_exactly_the_lost_ones_missing(options: str, form: str) -> None:
    bursts, lost, doubled = bad_journey(50, seed=8)
    assert min(len(lost), len(doubled)) > 30
    came = sorted({number for burst in bursts for number in burst})
    expected = [row for number in came for row in range(number * ROWS, (number + 1) * ROWS)]
    with wire(options) as (source, sender):
        blocks = []
        for burst in bursts:
            payloads = [message(number, form) for number in burst]
            for payload in payloads:  # a hundred fit into any kernel's buffer
                sender.send(payload)
            blocks += [block for block in [source.read(0.05)] if block is not None]
        blocks += heard(source, len(expected) - sum(map(len, blocks)))
    np.testing.assert_array_equal(rows(blocks), expected)
    assert counted(blocks, LossKind.MISSING) == len(lost) * ROWS
    assert counted(blocks, LossKind.REPEATED) == len(doubled) * ROWS
    assert {loss.kind for loss in losses(blocks)} <= {LossKind.MISSING, LossKind.REPEATED, LossKind.DROPPED}
    assert counted(blocks, LossKind.DROPPED) == 0


def test_rows_come_where_the_system_gives_no_times_of_reception(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows has no recvmsg."""
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(socket.socket, "recvmsg", None, raising=False)
    with wire() as (source, sender):
        sender.send(message(0))
        blocks = heard(source, ROWS)
    np.testing.assert_array_equal(rows(blocks), np.arange(ROWS))


def test_what_is_no_message_is_counted_between_those_that_are() -> None:
    long = json.dumps({"seq": ROWS, "time": [1.0] * 13_000}).encode()
    bad = [b"", b"\0", b"\xff" * 64_000, b'{"seq": 10, "time": 1, "b": 1}', b"1,2,3", message(1)[:-9], long]
    with wire() as (source, sender):
        for number, payload in enumerate(bad):
            sender.send(message(number))
            sender.send(payload)
        blocks = heard(source, len(bad) * ROWS)
    np.testing.assert_array_equal(rows(blocks), np.arange(len(bad) * ROWS))
    assert counted(blocks, LossKind.GARBLED) == len(bad)


def test_a_datagram_of_sixty_four_kilobytes_is_read_whole() -> None:
    with wire() as (source, sender):
        for number in range(3):
            sender.send(message(number, rows=2000))
        blocks = heard(source, 6000)
    np.testing.assert_array_equal(rows(blocks), np.arange(6000))


def test_stamps_of_1970_are_told_as_they_came() -> None:
    with wire() as (source, sender):
        for number in range(5):
            sender.send(message(number))
        blocks = heard(source, 5 * ROWS)
    np.testing.assert_array_equal(np.concatenate([block.time_s for block in blocks]), np.arange(5 * ROWS) / 1000)
    assert all(0 <= time.monotonic() - block.arrived_s < 60 for block in blocks)


def test_a_sender_that_begins_anew_is_said() -> None:
    with wire() as (source, sender):
        for began_s in (0.0, 1e6):
            for number in range(3):
                sender.send(message(number, began_s=began_s))
        blocks = heard(source, 6 * ROWS)
    np.testing.assert_array_equal(rows(blocks), [*range(3 * ROWS)] * 2)
    assert [loss.kind for loss in losses(blocks)] == [LossKind.GAP]


def test_a_producer_much_too_fast_is_counted() -> None:
    with wire("?buffer=65536") as (source, sender):
        for number in range(2000):
            sender.send(message(number))
        came = heard(source)
        sender.send(message(2000))
        blocks = came + heard(source, ROWS)
    missing, dropped = counted(blocks, LossKind.MISSING), counted(blocks, LossKind.DROPPED)
    assert dropped > 1000
    assert missing == dropped * ROWS  # both tell of the same
    assert len(rows(blocks)) == 2001 * ROWS - missing


def test_gathering_pauses_for_longer_while_little_waits_and_less_where_the_buffer_fills() -> None:
    with wire("?gather=40ms&buffer=262144") as (source, sender):
        pauses = []
        for number, burst in enumerate([1] * 8 + [150] * 3):
            for _ in range(burst):
                sender.send(message(number))
            assert source.read(30.0) is not None
            pauses.append(source._pause_s)
    np.testing.assert_allclose(pauses[:8], [2e-3, 4e-3, 8e-3, 16e-3, 32e-3, 40e-3, 40e-3, 40e-3])
    assert pauses[7] > pauses[8] > pauses[9] > pauses[10]


def test_what_comes_while_it_gathers_is_in_the_same_block(monkeypatch: pytest.MonkeyPatch) -> None:
    with wire("?gather=1ms") as (source, sender):
        waited: list[int] = []

        def waits(there: list[socket.socket], *more: object) -> tuple[list[socket.socket], list[object], list[object]]:
            waited.append(len(there))
            sender.send(message(len(waited) - 1))
            return there, [], []

        monkeypatch.setattr("becalm.live.sources.udp.select.select", waits)
        block = source.read(30.0)
        monkeypatch.undo()
    assert waited == [2, 1]  # for the first datagram, and then for nothing but an end
    assert block is not None
    assert len(block) == 2 * ROWS


def test_a_restart_sees_what_it_missed() -> None:
    with wire() as (source, sender):
        sender.send(message(0))
        (before,) = heard(source, ROWS)
        source.open(before.position)
        for number in (3, 0, 4):
            sender.send(message(number))
        blocks = heard(source, 2 * ROWS)
    np.testing.assert_array_equal(rows(blocks), np.arange(3 * ROWS, 5 * ROWS))
    assert counted(blocks, LossKind.MISSING) == 2 * ROWS
    assert counted(blocks, LossKind.REPEATED) == ROWS


def test_rows_without_stamps_have_the_time_at_which_the_kernel_had_them() -> None:
    began = time.time()
    with wire("?gather=200ms") as (source, sender):
        for number in range(4):
            sender.send(b'{"ax": %d, "ay": %d}' % (number, -number))
            time.sleep(0.01)
        blocks = heard(source, 4)
    stamps = np.concatenate([block.time_s for block in blocks])
    assert (np.diff(stamps) >= 0.005).all()
    assert began - 1 < stamps[0] < time.time() + 1


def test_a_read_ends_where_nothing_comes_and_where_another_thread_closes() -> None:
    with wire() as (source, _):
        assert source.read(0.01) is None
        closer = threading.Timer(0.05, source.close)
        closer.start()
        assert source.read(600.0) is None
        closer.join()
        with pytest.raises(EndOfStream):
            source.read(0.0)
        source.close()


def test_what_is_beyond_loopback_is_heard_only_where_it_is_said() -> None:
    with wire() as (source, _):
        assert source._socket is not None
        assert source._socket.getsockname()[0] == "127.0.0.1"
    with wire("?host=0.0.0.0") as (source, sender):
        sender.send(message(0))
        assert len(heard(source, ROWS)) == 1
    with wire("?host=::1") as (source, _):
        assert source.read(0.0) is None


def test_a_port_that_is_taken_is_a_sentence() -> None:
    with wire() as (source, sender):
        port = sender.getpeername()[1]
        other = UdpSource(Address.parsed(f"udp:{port}"))
        with pytest.raises(InputError, match=f"udp:{port} is used"):
            other.open("")
        other.close()
        assert source.read(0.0) is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("udp:", "names no port"),
        ("udp:0", "names no port"),
        ("udp:70000", "names no port"),
        ("udp:9000?gather=2s", "longer than 1s"),
        ("udp:9000?buffer=12", "buffer=12"),
        ("udp:9000?hots=a", "no option 'hots'"),
    ],
)
def test_an_address_that_cannot_be_is_refused(text: str, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        UdpSource(Address.parsed(text))


def test_a_host_that_is_none_and_a_position_of_another_source_are_sentences() -> None:
    source = UdpSource(Address.parsed("udp:9000?host=no such host"))
    with pytest.raises(InputError, match="not an address of this machine"):
        source.open("")
    with pytest.raises(InputError, match="not a position of udp"):
        source.open('{"row": 4}')


def test_a_small_buffer_is_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("becalm.live.sources.udp._BUFFER_FORCED", socket.SO_RCVBUF)
    most = Path("/proc/sys/net/core/rmem_max")
    if not most.exists():
        pytest.skip("this system does not say how large a buffer may be")
    granted = int(most.read_text())
    with wire(f"?buffer={granted * 2}") as (source, _):
        block = source.read(0.0)
        assert block is not None
        assert f"instead of {granted * 2}" in block.losses[0].says
        source.open("")
        assert source.read(0.0) is None
