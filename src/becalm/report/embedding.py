"""Embed scripts, styles and data in a page, so that it needs no network."""

from __future__ import annotations

import base64
import gzip
import re
from importlib.resources import files


def asset(name: str) -> str:
    """Return a file of report/assets as text."""
    return (files("becalm.report") / "assets" / name).read_text(encoding="utf-8")


def script(*names: str) -> str:
    """Join JavaScript modules into one script, because a page that is opened from a disk cannot import modules.

    Each module must come after all modules that it imports.
    """
    return "".join(re.sub(r'^import .* from "\.\.?/.*";\n', "", asset(name), flags=re.MULTILINE) for name in names)


def packed(data: bytes) -> str:
    """Return data compressed with gzip and encoded as base64; the page unpacks them."""
    return base64.b64encode(gzip.compress(data, mtime=0)).decode("ascii")
