"""Attacks by upload, on a real server: names that lead elsewhere, files too large, pages that die half-way."""

from __future__ import annotations

import errno
import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

import pytest

from becalm.web import uploads
from becalm.web.uploads import RefusedError, Uploads, checked_name
from served import LIMIT_BYTES, Served, served, until

SAID = b"PUT /files/drive.csv HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nCookie: %b\r\n"


@pytest.fixture
def page() -> Iterator[Served]:
    with served() as one:
        yield one


@pytest.fixture(scope="module")
def shared() -> Iterator[Served]:
    """Serve one page to all requests that change nothing there."""
    with served() as one:
        yield one


def kept(page: Served) -> list[Path]:
    return [path for path in page.page.uploads.folder.rglob("*") if path.is_file()]


def begun(page: Served) -> bytes:
    return SAID % (page.access.port, page.cookie.encode())


def still_served(page: Served) -> bool:
    with page.client() as browser:
        return browser.get("/").status_code == 200 and browser.put("/files/ok.csv", content=b"1\n").status_code == 200


def test_a_file_is_kept_as_it_was_sent_for_its_owner_only(page: Served) -> None:
    content = bytes(range(256)) * 10_000
    with page.client() as browser:
        for _ in range(2):  # a second one of that name stands beside the first
            assert browser.put("/files/Fahrt 1 (ü).csv", content=content).text == "Fahrt 1 (ü).csv"
        assert browser.put("/files/empty.csv", content=b"").status_code == 200
    assert sorted(path.name for path in kept(page)) == ["Fahrt 1 (ü).csv", "Fahrt 1 (ü).csv", "empty.csv"]
    assert {path.read_bytes() for path in kept(page)} == {content, b""}
    assert page.page.uploads.folder.stat().st_mode & 0o777 == 0o700
    folder = page.page.uploads.folder
    page.page.uploads.close()
    assert not folder.exists()


def test_without_a_file_there_is_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    uploads = Uploads(LIMIT_BYTES)
    uploads.close()
    assert list(tmp_path.iterdir()) == []
    assert uploads.folder.parent == tmp_path
    uploads.close()
    assert list(tmp_path.iterdir()) == []


HARMFUL = [
    "..",
    "%2e%2e",
    ".",
    "..%2f..%2fetc%2fpasswd",
    "%2e%2e%2f%2e%2e%2fa.csv",
    "%2Fetc%2Fpasswd",
    "/etc/passwd",
    "//etc/passwd",
    "../a.csv",
    "a/../../b.csv",
    "..%5c..%5ca.csv",
    "..\\a.csv",
    "a%00.csv",
    "a%0d%0aSet-Cookie:x.csv",
    "%1b[2Ja.csv",
    "a" * 256,
    "%c3%bc" * 128,
    "",
]


@pytest.mark.parametrize("name", HARMFUL, ids=range(len(HARMFUL)))
def test_a_name_that_leads_elsewhere_writes_nothing(shared: Served, name: str) -> None:
    before, page = kept(shared), shared
    sent = begun(page).replace(b"drive.csv", name.encode()) + b"Content-Length: 1\r\nConnection: close\r\n\r\nx"
    answer = page.raw(sent)
    assert answer.split(b" ")[1] in (b"400", b"404", b"405")
    assert kept(page) == before
    assert still_served(page)


def test_a_very_long_name_is_refused_before_it_is_read(page: Served) -> None:
    for letters in (2_000, 60_000, 1_000_000):
        answer = page.raw(begun(page).replace(b"drive.csv", b"a" * letters) + b"Content-Length: 0\r\n\r\n")
        assert answer == b"" or answer.split(b" ")[1] == b"400"
    assert kept(page) == []


@pytest.mark.parametrize("name", ["..", ".", "", "a/b", "a\\b", "/a", "a\x00", "a\n", "\x7f", "\ud800", "ü" * 128])
def test_names_that_are_none(name: str) -> None:
    with pytest.raises(RefusedError, match="is not a file name") as refused:
        checked_name(name)
    assert refused.value.status == 400


@pytest.mark.parametrize(
    "name", ["a", "...", "..a", "a..b.csv", " a b ", "-rf", "~", "$(id).csv", "12:30.csv", "ü" * 127]
)
def test_names_that_look_odd_and_are_plain(name: str) -> None:
    assert checked_name(name) == name


OUTSIDE = ["..%2f", "%2e%2e/%2e%2e/", "....//", "%2f", "//", "..%5c", "tuner/../../", "%00", "./"]
TARGETS = ["site.py", "assets/tuner.html", "etc/passwd", "uPlot.LICENSE"]


@pytest.mark.parametrize("path", [*(f"{name}site.py" for name in OUTSIDE), *TARGETS])
def test_assets_are_a_table_that_nothing_leads_out_of(shared: Served, path: str) -> None:
    sent = b"GET /assets/%b HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nCookie: %b\r\nConnection: close\r\n\r\n"
    answer = shared.raw(sent % (path.encode(), shared.access.port, shared.cookie.encode()))
    assert answer.split(b" ")[1] == b"404"
    with shared.client() as browser:
        assert browser.get(f"/assets/{path}").status_code == 404
        assert browser.get(f"/{quote(path)}").status_code == 404


def test_assets_that_are_there_are_given(page: Served) -> None:
    with page.client() as browser:
        for name in ("uPlot.iife.min.js", "uPlot.min.css", "numbers.js"):
            assert browser.get(f"/assets/{name}").status_code == 200


def test_a_file_at_the_limit_is_kept(page: Served) -> None:
    with page.client() as browser:
        assert browser.put("/files/a.csv", content=bytes(LIMIT_BYTES)).status_code == 200
    assert [path.stat().st_size for path in kept(page)] == [LIMIT_BYTES]


def test_a_file_that_says_it_is_too_large_is_not_read(page: Served) -> None:
    answer = page.raw(begun(page) + b"Content-Length: %d\r\n\r\n" % (LIMIT_BYTES + 1))  # nothing of it comes
    assert answer.split(b" ")[1] == b"413"
    assert b"is larger than 3 MB" in answer
    assert b"--upload-limit" in answer
    assert kept(page) == []


def test_a_file_of_unsaid_size_is_stopped_at_the_limit(page: Served) -> None:
    part = b"10000\r\n%b\r\n" % bytes(0x10000)
    with socket.create_connection(("127.0.0.1", page.access.port), 30) as link:
        link.sendall(begun(page) + b"Transfer-Encoding: chunked\r\n\r\n")
        sent, deadline = 0, time.monotonic() + 30
        try:
            while time.monotonic() < deadline:  # without end, until the server hangs up
                link.sendall(part)
                sent += 0x10000
        except (BrokenPipeError, ConnectionResetError):
            pass
    assert LIMIT_BYTES - 0x10000 < sent < 100 * LIMIT_BYTES
    until(lambda: kept(page) == [])
    assert list(page.page.uploads.folder.iterdir()) == []
    assert still_served(page)


def test_a_file_that_is_longer_than_it_said_is_cut_there(page: Served) -> None:
    answer = page.raw(begun(page) + b"Content-Length: 2\r\nConnection: close\r\n\r\n12GET / HTTP/1.1\r\n\r\n")
    assert answer.count(b"HTTP/1.1") == 1
    assert [path.read_bytes() for path in kept(page)] == [b"12"]


@pytest.mark.parametrize("length", [b"Content-Length: 2000000\r\n", b"Transfer-Encoding: chunked\r\n"])
def test_a_page_that_dies_half_way_leaves_nothing(page: Served, length: bytes) -> None:
    with socket.create_connection(("127.0.0.1", page.access.port), 30) as link:
        link.sendall(begun(page) + length + b"\r\n" + b"10000\r\n%b\r\n" % bytes(0x10000))
        until(lambda: len(kept(page)) == 1)  # it has begun
    until(lambda: list(page.page.uploads.folder.iterdir()) == [])
    assert still_served(page)


def test_all_files_together_have_a_limit(page: Served) -> None:
    with page.client() as browser:
        for _ in range(2):
            assert browser.put("/files/a.csv", content=bytes(LIMIT_BYTES - 1)).status_code == 200
        told = browser.put("/files/b.csv", content=b"123")
        unsaid = browser.put("/files/b.csv", content=iter([b"12", b"3"]))
        assert browser.put("/files/c.csv", content=b"12").status_code == 200  # nothing of what was refused counts
    for answer in (told, unsaid):
        assert answer.status_code == 413
        assert "b.csv does not fit: all dropped files together may have 6 MB" in answer.text
    assert sorted(path.name for path in kept(page)) == ["a.csv", "a.csv", "c.csv"]


def test_a_file_that_stops_coming_is_let_go(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "PATIENCE_S", 0.2)
    answer = page.raw(begun(page) + b"Content-Length: 3\r\n\r\n12")
    assert answer.split(b" ")[1] == b"408"
    assert b"No data of drive.csv arrived for 0.2 s" in answer
    assert list(page.page.uploads.folder.iterdir()) == []


@pytest.mark.parametrize("refuses", [(tempfile, "mkdtemp"), (Path, "mkdir")])
def test_a_disk_without_room_for_a_folder_is_told(
    page: Served, monkeypatch: pytest.MonkeyPatch, refuses: tuple[object, str]
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with page.client() as browser, monkeypatch.context() as patch:
        patch.setattr(*refuses, full)
        answer = browser.put("/files/a.csv", content=b"x")
    assert (answer.status_code, "No space left on device" in answer.text) == (507, True)
    assert still_served(page)


def test_a_full_disk_is_told_and_leaves_nothing(page: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    async def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with page.client() as browser:
        monkeypatch.setattr(Uploads, "_write", full)
        answer = browser.put("/files/a.csv", content=b"x")
    assert (answer.status_code, "No space left on device" in answer.text) == (507, True)
    assert list(page.page.uploads.folder.iterdir()) == []
