"""What a page holds that needs no network: its assets as text, its modules as one script, its data compressed."""

from __future__ import annotations

import base64
import gzip
import re
from importlib.resources import files


def asset(name: str) -> str:
    """Return a file of report/assets as text."""
    return (files("becalm.report") / "assets" / name).read_text(encoding="utf-8")


def script(*names: str) -> str:
    """Return modules as one script, each after those that it imports: a page on a disk can import none."""
    return "".join(re.sub(r'^import .* from "\.\.?/.*";\n', "", asset(name), flags=re.MULTILINE) for name in names)


def packed(data: bytes) -> str:
    """Return data compressed, in base64: the page unpacks it."""
    return base64.b64encode(gzip.compress(data, mtime=0)).decode("ascii")
