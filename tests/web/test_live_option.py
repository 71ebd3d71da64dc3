"""`becalm live --page` as a person types it: an address for them, no token in any log, and refusals in a sentence."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from becalm.core.recording import Recording
from becalm.files.outputs.writing import write
from becalm.web.access import LOOPBACK
from live_shown import recipe_of


@pytest.fixture
def words(tmp_path: Path) -> list[str]:
    """Return a stream that has ended before anyone can look."""
    values = np.random.default_rng(1).normal(size=(300, 2))
    write(tmp_path / "a.csv", Recording(values, names=["ax", "tilt"], units=["m", "deg"], rate_hz=1500.0))
    (tmp_path / "r.toml").write_text(recipe_of().to_toml(), encoding="utf-8")
    return ["replay:a.csv", "--recipe", "r.toml", "--log", "live.log", "--token-file", "token"]


def live(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "becalm", "live", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)


def test_the_address_is_for_a_person_and_for_no_log(words: list[str], tmp_path: Path) -> None:
    ran = live(tmp_path, *words, "--page", "0", "--status", "status.json")
    assert ran.returncode == 0
    assert ran.stdout == ""
    token = (tmp_path / "token").read_text().strip()
    assert f"/?token={token}\n" in ran.stderr
    assert (tmp_path / "token").stat().st_mode & 0o077 == 0
    for name in ("live.log", "status.json"):
        assert token not in (tmp_path / name).read_text()


def test_a_port_that_is_taken_is_told(words: list[str], tmp_path: Path) -> None:
    with socket.create_server((LOOPBACK, 0)) as taken:
        ran = live(tmp_path, *words, "--page", str(taken.getsockname()[1]))
    assert ran.returncode == 2
    assert "--page" in ran.stderr
    assert "Traceback" not in ran.stderr


def test_a_token_that_others_can_read_is_refused(words: list[str], tmp_path: Path) -> None:
    (tmp_path / "token").write_text("a-token-that-is-long-enough-for-all\n")
    (tmp_path / "token").chmod(0o644)
    ran = live(tmp_path, *words, "--page", "0")
    assert ran.returncode == 2
    assert "can be read by others" in ran.stderr


def test_other_machines_are_let_in_with_a_warning(words: list[str], tmp_path: Path) -> None:
    ran = live(tmp_path, *words, "--page", "0", "--page-host", "0.0.0.0")
    assert ran.returncode == 0
    assert "without TLS" in ran.stderr
    assert "leave --page-host out" in ran.stderr


def test_an_address_of_another_machine_is_refused(words: list[str], tmp_path: Path) -> None:
    ran = live(tmp_path, *words, "--page", "0", "--page-host", "192.0.2.1")
    assert ran.returncode == 2
    assert "give a name of this machine with --page-host, and a port with --page." in ran.stderr


def test_what_is_said_of_no_page_is_refused(words: list[str], tmp_path: Path) -> None:
    ran = live(tmp_path, *words)
    assert ran.returncode == 2
    assert "give --page PORT too" in ran.stderr
