"""Parse a stretch of time as a person writes it: START:STOP, each after the first row."""

from __future__ import annotations

import re
from math import inf

_TIME = re.compile(r"(?P<number>(\d+\.?\d*|\.\d+)(e[-+]?\d+)?)\s*(?P<unit>ms|s|min|h)?", re.IGNORECASE)
_SECONDS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}


def stretch_s(text: str) -> tuple[float, float] | None:
    """Return the start and end of a stretch of time, in seconds; None if the text is not such a stretch.

    Parameters
    ----------
    text : str
        START:STOP, each in seconds or with a unit: "0:30", "1min:2min".
    """
    ends = [_TIME.fullmatch(end.strip()) for end in text.split(":")]
    times_s = [float(end["number"]) * _SECONDS[(end["unit"] or "s").lower()] for end in ends if end]
    if len(ends) != 2 or len(times_s) != 2 or not times_s[0] < times_s[1] < inf:
        return None
    return times_s[0], times_s[1]
