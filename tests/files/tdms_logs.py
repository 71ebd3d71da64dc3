"""TDMS logs that tests write."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from nptdms import ChannelObject, TdmsWriter

ROWS = 60
SIGNAL = np.random.default_rng(7).normal(size=ROWS)
START = datetime(2024, 2, 29, 23, 59, 59)
WAVE: dict[str, Any] = {
    "wf_increment": 0.01,
    "wf_start_time": START,
    "wf_start_offset": 0.25,
    "wf_samples": 1,
    "unit_string": "m/s^2",
}


def written(folder: Path, *segments: list[Any], **said: Any) -> Path:
    path = folder / "log.tdms"
    with TdmsWriter(str(path), **said) as writer:
        for segment in segments:
            writer.write_segment(segment)
    return path


def channel(name: str, values: Any, group: str = "run", **properties: Any) -> ChannelObject:
    return ChannelObject(group, name, values, properties)
