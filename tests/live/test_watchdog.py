"""What notices a standstill: silence of a source, and systemd's watchdog."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from becalm.live.block import LossKind
from becalm.live.watching.watchdog import Silence, Systemd
from metered import Clock


def test_silence_is_said_once_and_once_more_when_it_ends() -> None:
    clock = Clock()
    silence = Silence(10, clock)
    clock.now_s += 10
    assert silence.record_no_rows() is None
    clock.now_s += 1
    began = silence.record_no_rows()
    assert began is not None
    assert (began.kind, began.rows, began.says) == (LossKind.SILENT, None, "Nothing came from the source for 11 s.")
    assert silence.silent
    clock.now_s += 30
    assert silence.record_no_rows() is None
    ended = silence.record_rows()
    assert ended is not None
    assert ended.says == "The source is back after 41 s of silence."
    assert not silence.silent
    assert silence.record_rows() is None


def test_a_source_that_keeps_coming_is_never_silent() -> None:
    clock = Clock()
    silence = Silence(1, clock)
    for _ in range(100):
        clock.now_s += 0.9
        assert silence.record_no_rows() is None
        assert silence.record_rows() is None


class Listener:
    """systemd's end of the notify socket."""

    def __init__(self, path: Path) -> None:
        self.door = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.door.bind(str(path))
        self.door.setblocking(False)
        self.environment = {"NOTIFY_SOCKET": str(path)}

    def heard(self) -> list[str]:
        said = []
        while True:
            try:
                said.append(self.door.recv(4096).decode())
            except BlockingIOError:
                return said


@pytest.fixture
def listener(tmp_path: Path) -> Iterator[Listener]:
    listener = Listener(tmp_path / "notify")
    yield listener
    listener.door.close()


def test_systemd_hears_what_the_stream_does(listener: Listener) -> None:
    systemd = Systemd(listener.environment)
    systemd.ready()
    systemd.status("Learning\nfor 30 s.")
    systemd.status("Learning\nfor 30 s.")
    systemd.status("Running.")
    systemd.stopping()
    systemd.close()
    systemd.close()
    systemd.status("Gone.")
    assert listener.heard() == ["READY=1", "STATUS=Learning for 30 s.", "STATUS=Running.", "STOPPING=1"]


def test_the_watchdog_hears_of_a_loop_that_turns_and_not_of_one_that_hangs(listener: Listener) -> None:
    clock = Clock()
    asked = {"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": str(os.getpid())}
    systemd = Systemd(listener.environment | asked, clock)
    for _ in range(31):
        systemd.ping_watchdog()
        clock.now_s += 1
    assert listener.heard() == ["WATCHDOG=1"] * 4  # at 0, 10, 20 and 30 s
    clock.now_s += 100
    assert listener.heard() == []
    systemd.close()


@pytest.mark.parametrize("asked", [{}, {"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": "soon"}])
def test_a_watchdog_that_is_not_meant_hears_nothing(listener: Listener, asked: dict[str, str]) -> None:
    systemd = Systemd(listener.environment | asked)
    systemd.ping_watchdog()
    systemd.close()
    assert listener.heard() == []


def test_an_abstract_socket_is_reached() -> None:
    door = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        door.bind(f"\0becalm-test-{os.getpid()}")
    except OSError:
        door.close()
        pytest.skip("this system has no abstract sockets")
    systemd = Systemd({"NOTIFY_SOCKET": f"@becalm-test-{os.getpid()}"})
    systemd.ready()
    assert door.recv(100) == b"READY=1"
    systemd.close()
    door.close()


@pytest.mark.parametrize("where", ["", "/no/such/socket", "vsock:2:1234"])
def test_without_systemd_nothing_happens(where: str) -> None:
    systemd = Systemd({"NOTIFY_SOCKET": where, "WATCHDOG_USEC": "1000000"})
    systemd.ready()
    systemd.ping_watchdog()
    systemd.stopping()
    systemd.close()


def test_a_listener_that_is_full_or_gone_stops_nothing(listener: Listener) -> None:
    systemd = Systemd(listener.environment)
    for number in range(2000):
        systemd.status(f"Row {number}.")
    assert 0 < len(listener.heard()) < 2000
    listener.door.close()
    systemd.status("On.")
    systemd.close()
