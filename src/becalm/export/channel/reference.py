"""What an exported channel is held against: the library's own, and what a controller is told where that is silent."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from becalm.cleaning.limits_entry import limits_of
from becalm.cleaning.live_channel import LiveChannel, open_live
from becalm.cleaning.recipe import ChannelRecipe
from becalm.core.arrays import Booleans, Codes, Floats
from becalm.core.filter.channel import Channel
from becalm.core.filter.channel_settings import ChannelSettings
from becalm.core.health.faults import Faults
from becalm.core.health.limits import Limits
from becalm.core.rows import EstimatedRows
from becalm.core.verdict import LOST, Verdict
from becalm.export.vectors import STARTING

_SINGLE = 1000  # rows of a gap that modes take one by one; see `native/device_modes.c`


class _ControllerReference(ABC):
    """Tells something of every row."""

    def __init__(self, limits: Limits) -> None:
        self._faults, self._entered = Faults(limits), 0.0

    def run(self, readings: Floats) -> tuple[Floats, Codes]:
        """Take readings (B,); return the signal and what became of each."""
        steps = np.ones(len(readings))
        (found, verdicts), across, believed = self._push(readings, steps)
        came = ~LOST[self._faults.push(readings, steps)] & believed
        codes = np.where((verdicts == Verdict.USED) & np.isnan(found), STARTING, verdicts)
        signal = np.where(verdicts == Verdict.HOLE, across, found)
        return np.where(np.isnan(signal), self._held(readings, came), signal), codes.astype(np.int8)

    @abstractmethod
    def _push(self, z: Floats, elapsed: Floats) -> tuple[tuple[Floats, Codes], Floats, Booleans]:
        """Take rows; return the signal and its verdicts, the signal that is told in any hole, and what is no spike."""

    def _across_gap(self, rows: int) -> None:
        """Go on for some rows without a reading, as one step."""
        missing, step = np.full(1, np.nan), np.full(1, float(rows))
        self._push(missing, step)
        self._faults.push(missing, step)

    def _held(self, readings: Floats, came: Booleans) -> Floats:
        """Return the last reading (B,) that came and was used, up to each row; 0 before the first."""
        entered = np.concatenate([[self._entered], np.where(came, readings, np.nan)])
        last = np.maximum.accumulate(np.where(np.isnan(entered), 0, np.arange(len(entered))))
        self._entered = float(entered[last[-1]])
        return np.asarray(entered[last[1:]], dtype=np.float64)


class ChannelReference(_ControllerReference):
    """One channel.

    Parameters
    ----------
    settings : ChannelSettings
        What it is made of.
    """

    def __init__(self, settings: ChannelSettings) -> None:
        super().__init__(settings.limits)
        self._channel, self._across = Channel(settings), Channel(settings._replace(unknown_from=np.inf))

    def gap(self, rows: int) -> None:
        """Go on for some rows without a reading, as one step."""
        if rows:
            self._across_gap(rows)

    def _push(self, z: Floats, elapsed: Floats) -> tuple[tuple[Floats, Codes], Floats, Booleans]:
        found = self._channel.process(z, elapsed)
        gated = (found.verdict == Verdict.RUNAWAY) & np.isnan(found.innovation)  # a verdict stands over another
        believed = (found.verdict != Verdict.SPIKE) & ~gated
        return (found.signal, found.verdict), self._across.process(z, elapsed).signal, believed


class ModesReference(_ControllerReference):
    """One channel that switches.

    Parameters
    ----------
    recipe : ChannelRecipe
        In seconds and units.
    step_s : float
        One step, in seconds.
    """

    def __init__(self, recipe: ChannelRecipe, step_s: float) -> None:
        super().__init__(limits_of(recipe.limits))
        self._channel = open_live(recipe, step_s, 0)
        self._across = open_live(recipe.model_copy(update={"fill": True}), step_s, 0)

    def gap(self, rows: int) -> None:
        """Go on for some rows without a reading: one by one up to a thousand, the rest as one step."""
        single = min(rows, _SINGLE)
        if single:
            self.run(np.full(single, np.nan))
        if rows > single:
            self._across_gap(rows - single)

    def _push(self, z: Floats, elapsed: Floats) -> tuple[tuple[Floats, Codes], Floats, Booleans]:
        found, across = _told(self._channel, z, elapsed), _told(self._across, z, elapsed)
        return (found.signal, found.verdicts), across.signal, found.verdicts != Verdict.SPIKE


def _told(channel: LiveChannel, z: Floats, elapsed: Floats) -> EstimatedRows:
    return EstimatedRows.joined(channel.push(z, elapsed))
