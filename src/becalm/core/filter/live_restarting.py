"""Restart the filter of a live channel after a gap beyond its limit; for files see `restarting_flow`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.channel_settings import GapLimit
from becalm.core.filter.restarting_flow import GapDetector
from becalm.core.reading_verdicts import judge as judge_readings
from becalm.core.rows import EstimatedRows


class LiveFlow(Protocol):
    """The interface of a filter for one part of a stream; the boundaries between pushes must change no bit."""

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows; return the rows whose estimates are final."""
        ...

    def finish(self) -> list[EstimatedRows]:
        """Return estimates of the waiting rows from the rows so far."""
        ...

    def state_dict(self) -> dict[str, Any]:
        """Return the state that later rows depend on, as arrays."""
        ...

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`."""
        ...


class LiveRestartingFlow:
    """A filter of one live channel that restarts after a long gap; for the parameters see `RestartingFlow`."""

    def __init__(self, open_flow: Callable[[], LiveFlow], gap_limit: GapLimit, largest: float) -> None:
        self._open_flow, self._largest = open_flow, largest
        self._gaps, self._flow = GapDetector(gap_limit), open_flow()

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return the rows whose estimates are final."""
        arrived = np.isfinite(judge_readings(z, self._largest).readings)
        estimates, begin = list[EstimatedRows](), 0
        for row in self._gaps.starts(arrived, elapsed):
            if row > begin:
                estimates += self._flow.push(z[begin:row], elapsed[begin:row])
            estimates += self._flow.finish()
            self._flow, begin = self._open_flow(), row
        return estimates + self._flow.push(z[begin:], elapsed[begin:])

    def finish(self) -> list[EstimatedRows]:
        """Return estimates of the waiting rows from the rows so far; this may change the state, so save it before."""
        return self._flow.finish()

    def state_dict(self) -> dict[str, Any]:
        """Return the state that later rows depend on, as arrays."""
        return self._flow.state_dict() | {"gaps": self._gaps.state_dict()}

    def load_state_dict(self, arrays: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`."""
        self._gaps.load_state_dict(arrays["gaps"])
        self._flow.load_state_dict(arrays)
