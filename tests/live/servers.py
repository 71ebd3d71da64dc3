"""Real servers on loopback: where a program is absent a test is skipped, but in CI it fails."""

from __future__ import annotations

import os

import pytest

from live_programs import free_port, program_path

__all__ = ["free_port", "need"]


def need(program: str) -> str:
    """Return the path of a server's program."""
    found = program_path(program)
    if found is not None:
        return found
    said = f"{program} is not installed here; Debian has it: apt-get install mosquitto postgresql"
    if os.environ.get("CI"):
        pytest.fail(said)
    pytest.skip(said)
