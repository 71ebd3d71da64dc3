"""A channel of a stream that starts anew after a gap beyond its limit; `restarting_flow` does so in files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.filter.gap_limit import GapLimit
from becalm.core.filter.restarting_flow import Gaps
from becalm.core.rows import EstimatedRows
from becalm.core.verdict import judge as judge_readings


class LiveFlow(Protocol):
    """What filters one part of a stream, so that any cut gives the same bits."""

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows; return what can be told for good."""
        ...

    def finish(self) -> list[EstimatedRows]:
        """Say that no more rows will come; return the rest."""
        ...

    def saved(self) -> dict[str, Any]:
        """Return what rows depend on, as arrays."""
        ...

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        ...


class LiveRestarting:
    """A filter of one channel of a stream; parameters as of `RestartingFlow`."""

    def __init__(self, open_flow: Callable[[], LiveFlow], gap_limit: GapLimit, largest: float) -> None:
        self._open_flow, self._largest = open_flow, largest
        self._gaps, self._flow = Gaps(gap_limit), open_flow()

    def push(self, z: Floats, elapsed: Floats) -> list[EstimatedRows]:
        """Take the next rows, readings (B,) and the steps before them; return what can be told for good."""
        arrived = np.isfinite(judge_readings(z, self._largest).readings)
        told, begin = list[EstimatedRows](), 0
        for row in self._gaps.starts(arrived, elapsed):
            if row > begin:
                told += self._flow.push(z[begin:row], elapsed[begin:row])
            told += self._flow.finish()
            self._flow, begin = self._open_flow(), row
        return told + self._flow.push(z[begin:], elapsed[begin:])

    def finish(self) -> list[EstimatedRows]:
        """Return what waits, by what there is after it; nothing changes by it that a snapshot would not bring back."""
        return self._flow.finish()

    def saved(self) -> dict[str, Any]:
        """Return what rows depend on, as arrays."""
        return self._flow.saved() | {"gaps": self._gaps.saved()}

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Take over what `saved` returned."""
        self._gaps.restore(arrays["gaps"])
        self._flow.restore(arrays)
