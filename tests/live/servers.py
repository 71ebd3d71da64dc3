"""Real servers on loopback: where a program is absent a test is skipped, but in CI it fails."""

from __future__ import annotations

import os
import shutil
import socket
from pathlib import Path

import pytest


def need(program: str) -> str:
    """Return the path of a server's program."""
    beside = [str(folder) for folder in sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)]
    places = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin", *beside])
    found = shutil.which(program, path=places)
    if found is not None:
        return found
    said = f"{program} is not installed here; Debian has it: apt-get install mosquitto postgresql"
    if os.environ.get("CI"):
        pytest.fail(said)
    pytest.skip(said)


def free_port() -> int:
    """Return a port of loopback that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
