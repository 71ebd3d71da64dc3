"""MDF logs that tests write."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from asammdf import MDF, Signal

ROWS = 60
TIMES = 100 + np.arange(ROWS) / 50
SIGNAL = np.random.default_rng(3).normal(size=ROWS)


def signal(name: str, samples: Any, **said: Any) -> Signal:
    return Signal(np.asarray(samples), said.pop("t", TIMES), name=name, **said)


def written(folder: Path, *groups: list[Signal], version: Any = "4.10", **said: Any) -> Path:
    path = folder / f"log{'.mf4' if version >= '4' else '.mdf'}"
    with MDF(version=version) as log:
        log.start_time = datetime(2024, 3, 1, 12, 30, tzinfo=UTC)
        for number, group in enumerate(groups):
            log.append(group, comment=f"group {number}", **said)
        log.save(path, overwrite=True)
    return path
