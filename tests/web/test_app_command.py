"""`becalm app` as a person types it: an address on stderr, a page behind it, and a quiet end."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from becalm.cli.commands.app import bytes_of
from becalm.errors import UsageError
from becalm.web.serving import listen
from served import PATIENCE_S, until

App = subprocess.Popen[str]

LISTENING = """
import signal
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # who runs this may ignore it
from becalm.cli.main import main
main()
"""


@contextmanager
def started(folder: Path, *words: str, **environment: str) -> Iterator[tuple[App, str]]:
    """Start it, and return it with the address that it printed."""
    command = [sys.executable, "-c", LISTENING, "app", *words]
    quiet = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")}
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env={**quiet, **environment},
    ) as process:
        try:
            assert process.stderr is not None
            line = process.stderr.readline()
            found = re.fullmatch(r"Open (http://\S+)\n", line)
            assert found is not None, line
            yield process, found[1]
        finally:
            process.kill()


def rest_of(process: App) -> tuple[int, str, str]:
    """Wait for its end; return its exit code, and what it said on stdout, and yet on stderr."""
    assert process.stdout is not None
    assert process.stderr is not None
    code = process.wait(PATIENCE_S)
    return code, process.stdout.read(), process.stderr.read()


def page_at(address: str) -> int:
    with httpx.Client(trust_env=False, follow_redirects=True, timeout=PATIENCE_S) as browser:
        return browser.get(address).status_code


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_page_is_behind_the_address_until_a_signal_ends_it_quietly(tmp_path: Path, number: signal.Signals) -> None:
    with started(tmp_path, "--port", "0") as (process, address):
        assert page_at(address) == 200
        assert page_at(address.partition("?")[0]) == 403
        process.send_signal(number)
        told = rest_of(process)
    assert told == (0, "", "Ctrl-C ends it.\n")


def test_a_token_outlives_a_restart(tmp_path: Path) -> None:
    words = ("--token-file", "token", "--port", "0")
    with started(tmp_path, *words) as (_, first), started(tmp_path, *words) as (_, second):
        assert first.partition("?")[2] == second.partition("?")[2]
        assert page_at(second) == 200
    assert (tmp_path / "token").stat().st_mode & 0o777 == 0o600


def test_without_a_port_a_second_page_finds_one(tmp_path: Path) -> None:
    with started(tmp_path) as (_, first), started(tmp_path) as (_, second):
        assert first.partition("?")[0] != second.partition("?")[0]
        assert [page_at(first), page_at(second)] == [200, 200]


def test_other_machines_are_let_in_with_a_warning_and_the_token(tmp_path: Path) -> None:
    with started(tmp_path, "--host", "0.0.0.0", "--port", "0") as (process, address):
        port = int(address.partition("/?")[0].rpartition(":")[2])
        assert page_at(f"http://127.0.0.1:{port}/") == 403
        assert page_at(f"http://127.0.0.1:{port}/?{address.partition('?')[2]}") == 200
        process.terminate()
        assert "without TLS" in rest_of(process)[2]


def test_a_browser_is_opened_with_an_address_that_serves_once(tmp_path: Path) -> None:
    """Others on the machine see what it was started with."""
    browser = tmp_path / "browser"
    browser.write_text('#!/bin/sh\necho "$1" > asked\nmv asked opened\n', encoding="utf-8")
    browser.chmod(0o755)
    with started(tmp_path, "--port", "0", BROWSER=str(browser)) as (process, address):
        opened = tmp_path / "opened"
        until(opened.exists)
        ticket = opened.read_text(encoding="utf-8").strip()
        assert ticket.partition("?")[0] == address.partition("?")[0]
        assert ticket != address
        assert [page_at(ticket), page_at(ticket), page_at(address)] == [200, 403, 403]
        process.terminate()
        assert "was used twice" in rest_of(process)[2]
    opened.unlink()
    with started(tmp_path, "--port", "0", "--no-browser", BROWSER=str(browser)) as (process, address):
        assert page_at(address) == 200
        process.terminate()
        rest_of(process)
    assert not opened.exists()


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["nothing.csv"], 3, "nothing.csv does not exist"),
        (["--folder", "nowhere"], 3, "nowhere is not a folder"),
        (["--rate", "100"], 2, "--rate and --time need a FILE; name one, or give its rate on the page"),
        (["--port", "99999"], 2, "the highest port is 65535"),
        (["--host", "192.0.2.1"], 2, "--host"),
        (["--upload-limit", "2"], 2, "write a number and then kB, MB or GB"),
        (["--token-file", "nowhere/token"], 2, "--token-file"),
    ],
)
def test_a_mistake_ends_in_a_sentence(tmp_path: Path, words: list[str], code: int, says: str) -> None:
    command = [sys.executable, "-m", "becalm", "app", "--no-browser", *words]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False, timeout=120)
    assert (ran.returncode, ran.stdout) == (code, "")
    assert says in ran.stderr
    assert ran.stderr.startswith("becalm: ")
    assert ran.stderr.count("\n") == 1


def test_a_port_that_was_asked_for_and_is_taken_is_told(tmp_path: Path) -> None:
    with listen("127.0.0.1", 0) as other:
        command = [sys.executable, "-m", "becalm", "app", "--no-browser", "--port", str(other.getsockname()[1])]
        ran = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False, timeout=120)
    assert ran.returncode == 2
    assert "another program uses it" in ran.stderr


@pytest.mark.parametrize("missing", ["starlette", "uvicorn", "websockets"])
def test_where_the_extra_is_missing_the_sentence_says_what_to_type(tmp_path: Path, missing: str) -> None:
    code = f"import sys; sys.modules[{missing!r}] = None; from becalm.cli.main import main; main()"
    command = [sys.executable, "-c", code, "app", "--no-browser"]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False, timeout=120)
    assert ran.returncode == 2
    assert f"{missing}, which must be installed; type: pip install 'becalm[app]'" in ran.stderr


def test_nothing_of_the_app_is_loaded_before_it_is_asked_for() -> None:
    code = "import sys, becalm.cli.main; print([n for n in sys.modules if n.split('.')[0] in %r])"
    ran = subprocess.run(
        [sys.executable, "-c", code % (["starlette", "uvicorn", "websockets", "webbrowser", "asyncio"],)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("text", "size"), [("2GB", 2_000_000_000), ("1.5 mb", 1_500_000), (".5kB", 500), ("1TB", 10**12)]
)
def test_a_size_is_read(text: str, size: int) -> None:
    assert bytes_of(text) == size


@pytest.mark.parametrize("text", ["", "2", "GB", "-1GB", "0GB", "nanMB", "1e3MB", "2GiB", "0.0001kB", "9" * 400 + "tb"])
def test_what_is_no_size_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="--upload-limit"):
        bytes_of(text)


@pytest.mark.skipif(os.name != "posix", reason="signals between processes")
def test_a_signal_is_heard_amid_a_wait_for_it() -> None:
    code = """
import os, signal
from becalm.cli.commands.app import _catch_signals
stopped = _catch_signals()
with stopped._cond:  # as whoever waits for it has it, for a moment
    os.kill(os.getpid(), signal.SIGINT)
assert stopped.wait(60)
os.kill(os.getpid(), signal.SIGINT)
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=PATIENCE_S, check=False)
    assert ran.returncode == 128 + signal.SIGINT, "a second one ends at once"
