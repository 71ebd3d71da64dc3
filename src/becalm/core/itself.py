"""How becalm starts another process of itself."""

from __future__ import annotations

import os
import sys
from pathlib import Path

MODULE = (sys.executable, "-P", "-m")
"""What runs a module: -P, for nothing in the folder where becalm was started is a part of it."""

_SOURCES = Path(__file__).parents[2]


def environment() -> dict[str, str]:
    """Return the environment in which another Python finds becalm where this one did."""
    places = [str(_SOURCES), os.environ.get("PYTHONPATH", "")]
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, places))}
