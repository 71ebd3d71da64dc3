"""Find the programs of servers, and a free port for them."""

from __future__ import annotations

import os
import shutil
import socket
from pathlib import Path


def program_path(program: str) -> str | None:
    """Return the path of a program; None if it is not installed."""
    postgres = [str(folder) for folder in sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)]
    places = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin", *postgres])
    return shutil.which(program, path=places)


def free_port() -> int:
    """Return a port of loopback that no program listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
