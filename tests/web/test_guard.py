"""Attacks on the door of a page, on a real server: who is no page of becalm with its token gets nothing."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from websockets.exceptions import ConnectionClosed, ConnectionClosedError, InvalidStatus

from becalm.web.guard import MOST_VIEWERS
from served import HTML, PATIENCE_S, TOKEN, Served, served, until

SECURITY = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cache-control": "no-store",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}


@pytest.fixture(scope="module")
def page() -> Iterator[Served]:
    with served() as one:
        yield one


def test_the_printed_address_lets_a_browser_in(page: Served) -> None:
    with page.stranger() as browser:
        first = browser.get(page.access.url)
        assert (first.status_code, first.headers["location"]) == (303, "/")
        assert first.headers["set-cookie"] == f"{page.cookie}; Path=/; HttpOnly; SameSite=Strict"
        second = browser.get("/")
        assert (second.status_code, second.text) == (200, HTML)
        assert browser.get("/assets/uPlot.min.css").headers["content-type"] == "text/css; charset=utf-8"
        assert browser.head("/").status_code == 200


def test_a_stolen_ticket_ends_all_that_goes_on(caplog: pytest.LogCaptureFixture) -> None:
    with served() as page, page.stranger() as thief, page.stranger() as browser, page.wire() as wire:
        wire.recv()
        address, printed = page.access.ticket(), page.access.url
        assert thief.get(address).status_code == 303
        assert thief.get("/").status_code == 200
        answer = browser.get(address)
        assert (answer.status_code, "used twice" in answer.text) == (403, True)
        with pytest.raises(ConnectionClosed):
            wire.recv(timeout=PATIENCE_S)
        assert [thief.get("/").status_code, browser.get(printed).status_code] == [403, 403]
        until(lambda: page.page.viewers == 0)
    assert [record.getMessage() for record in caplog.records if record.name == "becalm.web"] == [answer.text]


@pytest.mark.parametrize("path", ["/", "/?token=wrong", "/assets/uPlot.min.css", "/fail", "/nowhere", "/wire"])
def test_every_answer_is_secured(page: Served, path: str) -> None:
    with page.client() as known, page.stranger() as unknown:
        for answer in (known.get(path), unknown.get(path)):
            assert {name: answer.headers[name] for name in SECURITY} == SECURITY
            assert "server" not in answer.headers


@pytest.mark.parametrize(
    ("path", "cookie"),
    [
        ("/", None),
        ("/assets/uPlot.min.css", None),
        ("/nowhere", None),
        ("/?token=", None),
        ("/?token=wrong", None),
        (f"/?token={TOKEN[:-1]}", None),
        (f"/?token={TOKEN}x", None),
        (f"/?token={TOKEN.upper()}", None),
        (f"/?token=wrong&token={TOKEN}", None),
        (f"/assets/uPlot.min.css?token={TOKEN}", None),
        ("/", "becalm-{port}=wrong"),
        ("/", "becalm-{port}="),
        ("/", f"becalm-{{other}}={TOKEN}"),
        ("/", f"becalm={TOKEN}"),
        ("/", TOKEN),
        ("/?token=wrong", f"becalm-{{port}}={TOKEN}"),
    ],
)
def test_who_brings_no_token_gets_words_only(page: Served, path: str, cookie: str | None) -> None:
    port = page.access.port
    headers = {} if cookie is None else {"cookie": cookie.format(port=port, other=port + 1)}
    with page.stranger() as browser:
        answer = browser.get(path, headers=headers)
    assert answer.status_code == 403
    assert "becalm printed" in answer.text
    assert "set-cookie" not in answer.headers
    assert answer.headers["connection"] == "close"


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS"])
def test_only_opening_the_page_lets_in(page: Served, method: str) -> None:
    with page.stranger() as browser:
        assert browser.request(method, page.access.url).status_code == 403


def test_cookies_of_other_ports_stand_beside_ours(page: Served) -> None:
    odd = f'becalm-1=other; =; ;"broken; a=b=c; {page.cookie}; last'
    with page.stranger() as browser:
        assert browser.get("/", headers={"cookie": odd}).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"host": "evil.example"},
        {"host": "evil.example:{port}"},
        {"host": "127.0.0.1"},
        {"host": "127.0.0.1:{other}"},
        {"host": "127.0.0.1:{port}.evil.example"},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:{other}"},
        {"origin": "http://localhost:{port}"},
        {"origin": "https://127.0.0.1:{port}"},
        {"origin": ""},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"sec-fetch-site": "nonsense"},
    ],
    ids=str,
)
def test_what_comes_from_elsewhere_is_refused_although_it_brings_all(page: Served, headers: dict[str, str]) -> None:
    port = page.access.port
    made = {name: value.format(port=port, other=port + 1) for name, value in headers.items()}
    with page.client() as browser:
        assert browser.get("/", headers=made).status_code == 403
        assert browser.put("/files/a.csv", headers=made, content=b"x").status_code == 403
        login = browser.get(page.access.url, headers=made)
        assert login.status_code == 403
        assert "set-cookie" not in login.headers
    assert [*page.page.uploads.folder.iterdir()] == []


@pytest.mark.parametrize(
    "headers",
    [{"sec-fetch-site": "same-origin", "origin": "http://127.0.0.1:{port}"}, {"sec-fetch-site": "none"}, {}],
    ids=str,
)
def test_what_comes_from_the_page_is_answered(page: Served, headers: dict[str, str]) -> None:
    made = {name: value.format(port=page.access.port) for name, value in headers.items()}
    with page.client() as browser:
        assert browser.get("/", headers=made).status_code == 200


def test_a_request_without_or_with_two_hosts_is_refused(page: Served) -> None:
    cookie, port = page.cookie.encode(), page.access.port
    host = f"Host: 127.0.0.1:{port}\r\n".encode()
    cookies = b"Cookie: " + cookie + b"\r\n\r\n"
    assert page.raw(b"GET / HTTP/1.0\r\n" + host + cookies).startswith(b"HTTP/1.1 200")
    assert page.raw(b"GET / HTTP/1.0\r\n" + cookies).startswith(b"HTTP/1.1 403")
    assert page.raw(b"GET / HTTP/1.1\r\n" + host + b"Host: evil.example\r\n" + cookies).startswith(b"HTTP/1.1 400")


def test_a_page_speaks_and_another_does_not(page: Served) -> None:
    with page.wire() as wire:
        assert json.loads(wire.recv()) == {"kind": "welcome"}


@pytest.mark.parametrize(
    ("origin", "cookie", "host"),
    [
        (None, "ours", "127.0.0.1"),
        ("http://evil.example", "ours", "127.0.0.1"),
        ("null", "ours", "127.0.0.1"),
        ("http://127.0.0.1:1", "ours", "127.0.0.1"),
        ("ours", "ours", "evil.example"),
        ("ours", "ours", "localhost"),  # whose origin is another
        ("ours", None, "127.0.0.1"),
        ("ours", f"becalm-1={TOKEN}", "127.0.0.1"),
    ],
)
def test_a_wire_from_elsewhere_is_refused_before_it_opens(
    page: Served, origin: str | None, cookie: str | None, host: str
) -> None:
    with pytest.raises(InvalidStatus) as refused:
        page.wire(origin, cookie, host)
    assert refused.value.response.status_code == 403
    assert refused.value.response.headers["cache-control"] == "no-store"
    assert refused.value.response.body


def test_a_rebound_name_has_no_wire_of_its_own(page: Served) -> None:
    """A foreign name that was made to lead here: Host and Origin agree, and are not ours."""
    with pytest.raises(InvalidStatus) as refused:
        page.wire(f"http://evil.example:{page.access.port}", "ours", "evil.example")
    assert refused.value.response.status_code == 403


def test_a_wire_elsewhere_is_nowhere(page: Served) -> None:
    with page.client() as browser:
        assert browser.get("/wire").status_code == 404


def test_viewers_are_counted_and_the_next_is_told_why(page: Served) -> None:
    with ExitStack() as wires:
        for _ in range(MOST_VIEWERS):
            wire = wires.enter_context(page.wire())
            assert json.loads(wire.recv()) == {"kind": "welcome"}
        with page.wire() as late, pytest.raises(ConnectionClosedError) as refused:
            late.recv()
        assert refused.value.rcvd is not None
        assert refused.value.rcvd.code == 1013
        assert f"{MOST_VIEWERS} pages" in refused.value.rcvd.reason
    until(lambda: page.page.viewers == 0)
    with page.wire() as next_one:
        assert json.loads(next_one.recv()) == {"kind": "welcome"}


def test_a_mistake_is_told_although_it_is_no_unicode(page: Served) -> None:
    with page.client() as browser:
        answer = browser.get("/tell")
    assert (answer.status_code, answer.text) == (400, "caf?.csv is not there.")


def test_what_fails_in_becalm_is_told_to_whoever_runs_it_and_the_page_goes_on(
    page: Served, caplog: pytest.LogCaptureFixture
) -> None:
    with page.client() as browser:
        answer = browser.get("/fail")
        assert (answer.status_code, answer.text.endswith("its error output shows the cause.")) == (500, True)
    with page.wire() as wire:
        wire.recv()
        wire.send('{"do": "fail"}')
        with pytest.raises(ConnectionClosedError) as ended:
            wire.recv()
        assert ended.value.rcvd is not None
        assert ended.value.rcvd.code == 1011
    with page.client() as browser:
        assert browser.get("/").status_code == 200
    told = [record for record in caplog.records if record.name == "becalm.web"]
    assert [record.getMessage() for record in told] == ["A page's request failed."] * 2
    assert all(record.exc_info is not None for record in told)
