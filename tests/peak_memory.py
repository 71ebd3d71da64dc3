"""How much memory a program of Python holds at most, the same to some 40 MB at every run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PEAK = """
import pathlib as _pathlib, resource as _resource, sys as _sys
_status = _pathlib.Path("/proc/self/status")  # ru_maxrss would count what the parent held before
_peak = [line.split()[1] for line in _status.read_text().splitlines() if "VmHWM" in line] if _status.exists() else []
print(_peak[0] if _peak else _resource.getrusage(_resource.RUSAGE_SELF).ru_maxrss)
"""
ONE_HEAP = {"ARROW_DEFAULT_MEMORY_POOL": "system", "MALLOC_ARENA_MAX": "1"}
"""Heaps of each thread keep what was freed: with them the same run peaks up to 60 MB apart."""


def peak_mb(program: str, *words: str | Path) -> float:
    """Run a program with arguments, and return the most memory that it held."""
    arguments = [sys.executable, "-c", program + PEAK, *map(str, words)]
    ran = subprocess.run(arguments, capture_output=True, text=True, check=False, env={**os.environ, **ONE_HEAP})
    assert ran.returncode == 0, ran.stderr
    return int(ran.stdout) / 1024 / (1024 if sys.platform == "darwin" else 1)
