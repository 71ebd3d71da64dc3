"""Attacks by connections: idle ones, slow ones, wires that never open or take nothing."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import pytest

from becalm.web import serving, sockets
from becalm.web.sockets import TimeLimitedWebSocket
from served import KNOWN, UPGRADE, Served, filled, hung_up, link, served, still_served, until


@pytest.fixture
def page() -> Iterator[Served]:
    with served() as one:
        yield one


def test_two_hundred_idle_sockets_hold_up_nobody(page: Served) -> None:
    with ExitStack() as idle:
        for _ in range(200):
            idle.enter_context(link(page))
        assert still_served(page)
        with page.wire() as wire:
            assert json.loads(wire.recv()) == {"kind": "welcome"}
            for number in range(200):  # and who asks without the token is left at once
                one = idle.enter_context(link(page))
                one.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\n\r\n" % page.access.port)
                if number % 50 == 0:
                    assert still_served(page)
            wire.send('{"do": "look"}')
            assert json.loads(wire.recv())["kind"] == "heard"


def test_of_too_many_sockets_the_one_that_waited_longest_goes(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sockets, "REQUEST_S", 1e6)  # none goes for being late
    with ExitStack() as idle:
        first = idle.enter_context(link(page))
        for _ in range(sockets.MOST_SOCKETS + 20):
            idle.enter_context(link(page))
        assert hung_up(first)
        assert still_served(page)


def test_wires_that_never_open_give_their_place_to_others(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sockets, "REQUEST_S", 1e6)  # none goes for being late
    monkeypatch.setattr(TimeLimitedWebSocket, "handle_connect", lambda *_: None)  # nor for what it asked
    with ExitStack() as idle:
        first = idle.enter_context(link(page))
        first.sendall(b"GET /wire HTTP/1.1\r\n" + UPGRADE + b"Host: x\r\n\r\n")
        for _ in range(sockets.MOST_SOCKETS + 20):
            one = idle.enter_context(link(page))
            one.sendall(b"GET /wire HTTP/1.1\r\n" + UPGRADE + b"Host: x\r\n\r\n")
        assert hung_up(first)
        assert still_served(page)


def test_a_wire_that_never_opens_is_left(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sockets, "REQUEST_S", 0.3)
    monkeypatch.setattr(TimeLimitedWebSocket, "handle_connect", lambda *_: None)
    with link(page) as slow:
        slow.sendall(b"GET /wire HTTP/1.1\r\n" + UPGRADE + b"Host: x\r\n\r\n")
        assert hung_up(slow)


@pytest.mark.parametrize("begun", [b"", b"G", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: "])
def test_who_never_ends_a_request_is_left(page: Served, monkeypatch: pytest.MonkeyPatch, begun: bytes) -> None:
    monkeypatch.setattr(sockets, "REQUEST_S", 0.3)
    with link(page) as slow:
        slow.sendall(begun)
        assert hung_up(slow)


def test_who_sends_headers_byte_by_byte_is_left(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every byte restarts no clock."""
    monkeypatch.setattr(sockets, "REQUEST_S", 0.5)
    left = threading.Event()
    with link(page) as slow:

        def listen_for_the_end() -> None:
            if hung_up(slow):
                left.set()

        ear = threading.Thread(target=listen_for_the_end)
        ear.start()
        for _ in range(300):
            try:
                slow.sendall(b"X")
            except OSError:
                break
            if left.wait(0.1):
                break
        ear.join()
    assert left.is_set()


def test_who_is_slow_with_a_second_request_is_left_too(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = b"GET /nowhere HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nCookie: %b\r\n\r\n"
    monkeypatch.setattr(sockets, "REQUEST_S", 0.3)
    with link(page) as slow:
        slow.sendall(asked % (page.access.port, page.cookie.encode()))
        assert slow.recv(65536).startswith(b"HTTP/1.1 404")
        slow.sendall(b"GET / HT")
        while slow.recv(65536):  # what is left of the first answer
            pass


def test_a_wire_is_left_open_although_nothing_is_said(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sockets, "REQUEST_S", 0.5)
    with page.wire() as wire:
        wire.recv()
        with pytest.raises(TimeoutError):
            wire.recv(timeout=1.5)
        wire.send('{"do": "look"}')
        assert json.loads(wire.recv())["kind"] == "heard"


def test_a_page_that_takes_nothing_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "PING_S", 1.0)
    long = json.dumps({"do": "x" * 1_000_000}).encode()
    key = b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    with served() as page, link(page) as deaf:
        deaf.sendall(
            filled(page, b"GET /wire HTTP/1.1\r\n" + KNOWN + b"Origin: http://127.0.0.1:{port}\r\n" + UPGRADE + key)
        )
        until(lambda: page.page.viewers == 1)
        deaf.settimeout(3)
        with suppress(OSError):  # until no more goes in, or it is let go
            while True:
                deaf.sendall(b"\x81\xff" + len(long).to_bytes(8, "big") + bytes(4) + long)
        until(lambda: page.page.viewers == 0)
