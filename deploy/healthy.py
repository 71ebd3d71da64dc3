"""Whether a stream is alive, by its status file: python healthy.py STATUS; exits with 0, or with why not."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

OLDEST_S = 15.0
"""It is written every second."""

LONGEST_TURN_S = 60.0
"""The main loop comes round several times a second."""


def trouble(path: Path) -> str | None:
    """Return what is wrong; a source that is away or silent is not, as a restart would not bring it back."""
    try:
        status = json.loads(path.read_text(encoding="utf-8"))
        age_s = time.time() - path.stat().st_mtime
    except (OSError, ValueError) as cause:
        return f"No status: {cause}"
    if age_s > OLDEST_S:
        return f"The status is {age_s:.0f} s old."
    if status["loop_age_s"] > LONGEST_TURN_S:
        return f"The main loop has stood still for {status['loop_age_s']:.0f} s."
    return f"The stream failed. {status['says']}" if status["state"] == "failed" else None


if __name__ == "__main__":
    sys.exit(trouble(Path(sys.argv[1])))
