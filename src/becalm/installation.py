"""The installed version of becalm, its subprocesses and typed commands, and imports to do before threads start."""

from __future__ import annotations

import os
import shlex
import sys
from functools import cache
from importlib import metadata
from pathlib import Path

MODULE = (sys.executable, "-P", "-m")
"""Command that runs a module in a subprocess; -P keeps the current folder out of the import path."""

_SOURCES = Path(__file__).parents[1]  # the folder with the package becalm


@cache
def version() -> str:
    """Return the version of becalm; "" if becalm is on the path but not installed."""
    try:
        return metadata.version("becalm")
    except metadata.PackageNotFoundError:
        return ""


def load_scipy() -> None:
    """Import the shared parts of SciPy before threads do, because threads could see partly imported modules."""
    import scipy.optimize  # noqa: F401


def typed(*words: str) -> str:
    """Return words as they are typed on a command line of this system, quoted where needed."""
    if os.name == "nt":
        from subprocess import list2cmdline

        return list2cmdline(words)
    return shlex.join(words)


def environment() -> dict[str, str]:
    """Return the environment in which a subprocess imports becalm from the same place as this process."""
    paths = [str(_SOURCES), os.environ.get("PYTHONPATH", "")]
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
