"""Names, tokens and tickets: who may see a page."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from becalm.errors import UsageError
from becalm.web import access as door
from becalm.web.access import Access, TicketReusedError, token_of

TOKEN = "a-token-that-is-long-enough-for-all"
HERE = socket.gethostname()


@pytest.mark.parametrize(
    ("host", "port", "asked", "ours"),
    [
        ("127.0.0.1", 8765, "127.0.0.1:8765", True),
        ("127.0.0.1", 8765, "localhost:8765", True),
        ("127.0.0.1", 8765, "LOCALHOST:8765", True),
        ("127.0.0.1", 8765, "[::1]:8765", True),
        ("localhost", 8765, "localhost:8765", True),
        ("127.0.0.2", 8765, "127.0.0.2:8765", True),
        ("127.0.0.1", 8765, "127.0.0.1", False),
        ("127.0.0.1", 8765, "127.0.0.1:8766", False),
        ("127.0.0.1", 8765, "127.0.0.1:87650", False),
        ("127.0.0.1", 8765, "evil.example:8765", False),
        ("127.0.0.1", 8765, "localhost.evil.example:8765", False),
        ("127.0.0.1", 8765, "evil.example:8765@127.0.0.1:8765", False),
        ("127.0.0.1", 8765, "192.168.1.5:8765", False),
        ("127.0.0.1", 8765, "", False),
        ("127.0.0.1", 8765, ":8765", False),
        ("127.0.0.1", 80, "127.0.0.1", True),
        ("127.0.0.1", 80, "localhost:80", True),
        ("lab.example", 8765, "lab.example:8765", True),
        ("lab.example", 8765, "localhost:8765", False),
        ("0.0.0.0", 8765, "192.168.1.5:8765", True),
        ("0.0.0.0", 8765, "[fe80::1]:8765", True),
        ("0.0.0.0", 8765, f"{HERE}:8765", True),
        ("0.0.0.0", 8765, "evil.example:8765", False),
        ("0.0.0.0", 8765, "192.168.1.5", False),
    ],
)
def test_a_page_knows_its_names(host: str, port: int, asked: str, ours: bool) -> None:
    assert Access(host, port, TOKEN).is_own_host(asked) is ours


@pytest.mark.parametrize(
    ("origin", "same"),
    [
        ("http://127.0.0.1:8765", True),
        ("https://127.0.0.1:8765", False),
        ("http://localhost:8765", False),
        ("http://127.0.0.1:8766", False),
        ("http://127.0.0.1:8765.evil.example", False),
        ("null", False),
        ("", False),
    ],
)
def test_only_the_page_itself_has_its_origin(origin: str, same: bool) -> None:
    assert Access.same_origin(origin, "127.0.0.1:8765") is same


@pytest.mark.parametrize(
    ("host", "url"),
    [
        ("127.0.0.1", "http://127.0.0.1:9/"),
        ("LocalHost", "http://127.0.0.1:9/"),
        ("::1", "http://[::1]:9/"),
        ("0.0.0.0", f"http://{HERE}:9/"),
    ],
)
def test_the_address_holds_the_token(host: str, url: str) -> None:
    assert Access(host, 9, TOKEN).url == f"{url}?token={TOKEN}"


@pytest.mark.parametrize(("host", "warned"), [("127.0.0.1", False), ("localhost", False), ("::1", False), ("::", True)])
def test_other_machines_are_let_in_with_a_warning(host: str, warned: bool) -> None:
    warning = Access(host, 9, TOKEN).warning
    assert (warning is not None) is warned
    assert not warned or "without TLS" in str(warning)


def ticket_of(access: Access) -> str:
    return urlsplit(access.ticket()).query.removeprefix("token=")


def test_a_ticket_opens_the_page_and_so_does_the_token() -> None:
    access = Access("0.0.0.0", 9, TOKEN)
    assert urlsplit(access.ticket()).netloc == "127.0.0.1:9"
    ticket = ticket_of(access)
    assert ticket != TOKEN
    assert not access.is_token(ticket)  # it is no cookie
    assert access.admits(ticket)
    assert [access.admits(TOKEN), access.admits(TOKEN), access.admits(TOKEN[:-1]), access.admits("")] == [
        True,
        True,
        False,
        False,
    ]
    assert not access.admits("ü" * 40)


def test_a_ticket_that_comes_twice_ends_all(monkeypatch: pytest.MonkeyPatch) -> None:
    access = Access("127.0.0.1", 9, TOKEN)
    ticket, unused = ticket_of(access), ticket_of(access)
    assert access.admits(ticket)
    monkeypatch.setattr(door, "_TICKET_S", 0.0)  # the browser was late, and somebody else was not
    with pytest.raises(TicketReusedError, match="used twice"):
        access.admits(ticket)
    assert [access.admits(unused), access.admits(TOKEN), access.is_token(TOKEN)] == [False, False, False]


def test_a_ticket_that_was_late_opens_nothing_and_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    access = Access("127.0.0.1", 9, TOKEN)
    ticket = ticket_of(access)
    monkeypatch.setattr(door, "_TICKET_S", 0.0)
    assert [access.admits(ticket), access.admits(ticket), access.admits(TOKEN)] == [False, False, True]


def test_a_ticket_that_comes_again_much_later_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """It stays in the list of processes for as long as the browser runs."""
    access = Access("127.0.0.1", 9, TOKEN)
    ticket = ticket_of(access)
    assert access.admits(ticket)
    monkeypatch.setattr(door, "_WATCHED_S", 0.0)
    assert [access.admits(ticket), access.admits(TOKEN)] == [False, True]


def test_a_token_file_is_made_for_its_owner_only_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "token"
    token = token_of(path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert token_of(path) == token
    assert token not in (token_of(None), token_of(tmp_path / "other"))
    assert len(token) >= 43


@pytest.mark.parametrize(
    ("text", "mode", "says"),
    [
        (TOKEN, 0o640, "can be read by others"),
        (TOKEN, 0o604, "can be read by others"),
        ("short", 0o600, "does not contain a token"),
        ("a token with spaces, and long enough", 0o600, "does not contain a token"),
        ("a" * 2000, 0o600, "does not contain a token"),
        ("", 0o600, "does not contain a token"),
    ],
)
def test_a_file_that_keeps_no_secret_is_refused(tmp_path: Path, text: str, mode: int, says: str) -> None:
    path = tmp_path / "token"
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)
    with pytest.raises(UsageError, match=says):
        token_of(path)


@pytest.mark.skipif(os.name != "posix", reason="owners of files")
def test_a_file_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "token"
    token_of(path)
    owner = path.stat().st_uid
    monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
    with pytest.raises(UsageError, match="belongs to another user"):
        token_of(path)


@pytest.mark.parametrize("name", [".", "missing/token"])
def test_a_file_that_cannot_be_is_told(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="--token-file"):
        token_of(tmp_path / name)


@pytest.mark.skipif(os.name != "posix", reason="modes of files")
def test_a_file_of_before_with_a_tight_mode_serves(tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.touch(0o600)
    path.write_text(f"  {TOKEN}\n", encoding="ascii")
    assert token_of(path) == TOKEN
