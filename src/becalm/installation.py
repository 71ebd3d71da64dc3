"""Which becalm this is, how it starts another process of itself, and what it loads before threads."""

from __future__ import annotations

import os
import sys
from functools import cache
from importlib import metadata
from pathlib import Path

MODULE = (sys.executable, "-P", "-m")
"""What runs a module: -P, for nothing in the folder where becalm was started is a part of it."""

_SOURCES = Path(__file__).parents[1]


@cache
def version() -> str:
    """Return becalm's version, "" where it is on the path and not installed."""
    try:
        return metadata.version("becalm")
    except metadata.PackageNotFoundError:
        return ""


def load_scipy() -> None:
    """Load what of SciPy its parts share, before threads load them: each would find what another has half loaded."""
    import scipy.optimize  # noqa: F401


def environment() -> dict[str, str]:
    """Return the environment in which another Python finds becalm where this one did."""
    places = [str(_SOURCES), os.environ.get("PYTHONPATH", "")]
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, places))}
