"""Attacks on the server itself: nonsense, messages that are none; and its end."""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosedError
from websockets.sync.client import ClientConnection

from becalm.errors import UsageError
from becalm.web.access import LOOPBACK, Access
from becalm.web.serving import MAX_MESSAGE_BYTES, PortInUseError, Server, listen
from becalm.web.site import Page, site
from served import HOST, HTML, KNOWN, TOKEN, UPGRADE, Served, filled, hung_up, link, served, still_served, until


@pytest.fixture
def page() -> Iterator[Served]:
    with served() as one:
        yield one


@pytest.fixture(scope="module")
def shared() -> Iterator[Served]:
    """Serve one page to all requests that are refused."""
    with served() as one:
        yield one


SMUGGLED = b"GET /fail HTTP/1.1\r\n" + KNOWN + b"\r\n"
PUT = b"PUT /files/a HTTP/1.1\r\n" + KNOWN
NO_WIRE = [  # what HTTP allows, and WebSocket does not
    b"GET /wire HTTP/1.1\r\n" + HOST + UPGRADE + b"Content-Length: 1\r\n\r\n",
    b"GET /wire HTTP/1.1\r\n" + HOST + UPGRADE + b"Transfer-Encoding: chunked\r\n\r\n",
    b"GET /wire HTTP/1.1\r\n" + HOST + UPGRADE + b"X: y\r\n" * 129 + b"\r\n",
    b"GET /wire HTTP/1.1\r\n" + HOST + UPGRADE + b"X: " + b"y" * 9000 + b"\r\n\r\n",
    b"GET /" + b"y" * 9000 + b" HTTP/1.1\r\n" + HOST + UPGRADE + b"\r\n",
    b"POST /wire HTTP/1.1\r\n" + HOST + UPGRADE + b"Content-Length: 1\r\n\r\n",
]
NONSENSE = [
    *NO_WIRE,
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(200),  # TLS
    b"\x00" * 1000,
    b"GET\r\n\r\n",
    b"GET http://evil.example/ HTTP/1.1\r\nHost: evil.example\r\n\r\n",
    b"CONNECT evil.example:443 HTTP/1.1\r\nHost: evil.example:443\r\n\r\n",
    b"GET / HTTP/1.1\r\n\r\n",
    b"GET / HTTP/1.1\r\n" + KNOWN + b"Host : x\r\n\r\n",
    b"GET / HTTP/1.1\r\n" + KNOWN + b"X: " + b"a" * 400_000 + b"\r\n\r\n",
    b"GET / HTTP/1.1\r\n" + KNOWN + b"X: a\x00b\r\n\r\n",
    b"GET /\xff\xfe HTTP/1.1\r\n" + KNOWN + b"\r\n",
    PUT + b"Content-Length: -1\r\n\r\n",
    PUT + b"Content-Length: 1e3\r\n\r\n",
    PUT + b"Content-Length: 1\r\nContent-Length: 90\r\n\r\nx" + SMUGGLED,
    PUT + b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n" + SMUGGLED,
    PUT + b"Transfer-Encoding: xchunked\r\n\r\n0\r\n\r\n" + SMUGGLED,
    PUT + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n\r\n" + SMUGGLED,
    b"GET / HTTP/1.1\r\n" + HOST + b"\r\n" + SMUGGLED,  # behind one that is refused
    b"GET /wire HTTP/1.1\r\n" + KNOWN + b"Connection: Upgrade\r\nUpgrade: websocket\r\n\r\n",
    b"GET /wire HTTP/1.1\r\n" + HOST + b"Connection: Upgrade\r\nUpgrade: h2c\r\n\r\n" + SMUGGLED,
    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
]


@pytest.mark.parametrize("sent", NONSENSE, ids=range(len(NONSENSE)))
def test_nonsense_is_refused_once_and_reaches_no_page(
    shared: Served, sent: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    page = shared
    answer = page.raw(filled(page, sent))
    assert answer.startswith((b"HTTP/1.1 4", b"HTTP/1.1 5"))
    assert answer.count(b"HTTP/1.1 ") == 1
    until(lambda: list(page.page.uploads.folder.iterdir()) == [])
    assert [record for record in caplog.records if record.name == "becalm.web"] == []  # as /fail would tell
    assert still_served(page)


def test_the_cookies_of_many_pages_are_no_hindrance(page: Served) -> None:
    cookies = f"{page.cookie}; other={'x' * 50_000}"
    with page.stranger() as browser:
        assert browser.get("/", headers={"cookie": cookies}).text == HTML
    with page.wire(cookie=cookies) as wire:
        assert heard_of(wire) == {"kind": "welcome"}


def test_what_is_smuggled_would_fail_if_it_were_answered(page: Served, caplog: pytest.LogCaptureFixture) -> None:
    sent = filled(page, SMUGGLED)
    assert page.raw(sent[:-2] + b"Connection: close\r\n\r\n").startswith(b"HTTP/1.1 500")
    assert [record.name for record in caplog.records if record.name == "becalm.web"] == ["becalm.web"]


def heard_of(wire: ClientConnection) -> dict[str, object]:
    told = json.loads(wire.recv())
    assert isinstance(told, dict)
    return told


def test_messages_that_are_none_are_told_so_and_the_wire_stays_open(page: Served) -> None:
    with page.wire() as wire:
        wire.recv()
        for sent in ("", "{", "[]", "null", '{"q": NaN}', '{"q": 1e999}', "[" * 100_000, b"\x00\x01", b"{}"):
            wire.send(sent)
            assert heard_of(wire)["kind"] == "trouble"
        wire.send('{"do": "look", "q": 1.5}')
        assert heard_of(wire)["said"] == {"do": "look", "q": 1.5}


def test_a_message_without_end_is_cut_off(page: Served) -> None:
    with page.wire() as wire:
        wire.recv()
        wire.send('{"a": "' + "x" * (MAX_MESSAGE_BYTES - 9) + '"}')  # as much as may be said
        assert heard_of(wire)["kind"] == "heard"
        wire.socket.sendall(struct.pack("!BBQ4s", 0x81, 0xFF, 2 << 20, b"mask"))  # a text of 2 MiB will follow
        with pytest.raises(ConnectionClosedError) as ended:
            wire.recv()
    assert ended.value.rcvd is not None
    assert ended.value.rcvd.code == 1009
    until(lambda: page.page.viewers == 0)
    assert still_served(page)


def test_text_that_is_none_ends_its_wire_only(page: Served) -> None:
    with page.wire() as wire:
        wire.recv()
        wire.send(b"\xff\xfe", text=True)
        with pytest.raises(ConnectionClosedError):
            wire.recv()
    assert still_served(page)


def test_a_server_that_ends_says_so_and_gives_its_port_back() -> None:
    with ExitStack() as opened:
        with served() as page:
            wire = opened.enter_context(page.wire())
            wire.recv()
            idle = opened.enter_context(link(page))
        with pytest.raises(ConnectionClosedError) as ended:
            wire.recv()
        assert ended.value.rcvd is not None
        assert ended.value.rcvd.code == 1012  # the service restarts: a page comes back by itself
        assert hung_up(idle)
    listen(LOOPBACK, page.access.port).close()


def test_a_server_may_be_closed_before_it_began_and_twice() -> None:
    listener = listen(LOOPBACK, 0)
    port = listener.getsockname()[1]

    async def silent(_: object) -> None:
        """Say nothing."""

    server = Server(listener, site(Page(HTML, silent), Access(LOOPBACK, port, TOKEN)))
    server.close()
    server.close()
    listen(LOOPBACK, port).close()


def test_a_port_that_is_taken_is_told() -> None:
    with listen(LOOPBACK, 0) as first, pytest.raises(PortInUseError, match=r"another program uses it; give .* --port"):
        listen(LOOPBACK, first.getsockname()[1])


@pytest.mark.parametrize(
    ("host", "port", "says"),
    [
        (LOOPBACK, 65536, "the highest port is 65535"),
        (LOOPBACK, -1, "the highest port is 65535"),
        ("192.0.2.1", 0, "--host"),  # an address of nobody
        ("..a", 0, "is not a host name"),
    ],
)
def test_a_place_that_cannot_be_is_told(host: str, port: int, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        listen(host, port)


def test_localhost_is_one_address_although_it_has_two(monkeypatch: pytest.MonkeyPatch) -> None:
    found = socket.getaddrinfo

    def both(host: str, *rest: Any, **options: Any) -> Any:
        return found("::1" if host == "localhost" else host, *rest, **options)

    monkeypatch.setattr(socket, "getaddrinfo", both)
    with listen("localhost", 0) as listener:
        assert listener.getsockname()[0] == LOOPBACK


def test_the_other_loopback_serves_as_well() -> None:
    try:
        listener = listen("::1", 0)
    except UsageError:
        pytest.skip("this machine has no IPv6")
    port = listener.getsockname()[1]

    async def silent(_: object) -> None:
        """Say nothing."""

    with Server(listener, site(Page(HTML, silent), Access("::1", port, TOKEN))):
        asked = b"GET / HTTP/1.1\r\nHost: [::1]:%d\r\nCookie: becalm-%d=%b\r\nConnection: close\r\n\r\n"
        with socket.create_connection(("::1", port), 30) as one:
            one.sendall(asked % (port, port, TOKEN.encode()))
            assert one.recv(20).startswith(b"HTTP/1.1 200")
