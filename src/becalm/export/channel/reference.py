"""Define the references for exported channels: the library's own channels, with which the C is compared.

Where the library returns NaN, a reference returns the number that the C code returns on a controller.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from becalm.cleaning.channels.live_channel import LiveChannel, open_live
from becalm.cleaning.recipes.limits_entry import limits_of
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.arrays import Booleans, Codes, Floats
from becalm.core.filter.channel import Channel
from becalm.core.filter.channel_settings import ChannelSettings
from becalm.core.health.faults import Faults
from becalm.core.health.limits import Limits
from becalm.core.reading_verdicts import LOST, Verdict
from becalm.core.rows import EstimatedRows
from becalm.export.vectors import STARTING

_SINGLE = 1000  # first rows of a gap, which an IMM processes one by one; see `native/device_modes.c`


class _ControllerReference(ABC):
    """A reference that returns a finite signal for each row."""

    def __init__(self, limits: Limits) -> None:
        self._faults, self._last = Faults(limits), 0.0

    def run(self, readings: Floats) -> tuple[Floats, Codes]:
        """Process readings (B,); return the signal (B,) and the codes (B,)."""
        steps = np.ones(len(readings))
        (signal, verdicts), across, accepted = self._push(readings, steps)
        used = ~LOST[self._faults.push(readings, steps)] & accepted
        codes = np.where((verdicts == Verdict.USED) & np.isnan(signal), STARTING, verdicts)
        output = np.where(verdicts == Verdict.HOLE, across, signal)
        return np.where(np.isnan(output), self._last_used(readings, used), output), codes.astype(np.int8)

    @abstractmethod
    def _push(self, z: Floats, elapsed: Floats) -> tuple[tuple[Floats, Codes], Floats, Booleans]:
        """Process readings (B,) with the steps since the previous row (B,).

        Return the signal with its verdicts, a signal that also has a prediction in every hole, and a mask of the
        readings that were not rejected as spikes.
        """

    def _across_gap(self, rows: int) -> None:
        """Advance by `rows` rows without a reading, as one step."""
        missing, step = np.full(1, np.nan), np.full(1, float(rows))
        self._push(missing, step)
        self._faults.push(missing, step)

    def _last_used(self, readings: Floats, used: Booleans) -> Floats:
        """Return, for each row, the last used reading up to this row, (B,); 0 before the first used reading."""
        inputs = np.concatenate([[self._last], np.where(used, readings, np.nan)])
        last = np.maximum.accumulate(np.where(np.isnan(inputs), 0, np.arange(len(inputs))))
        self._last = float(inputs[last[-1]])
        return np.asarray(inputs[last[1:]], dtype=np.float64)


class ChannelReference(_ControllerReference):
    """A reference for one channel with a single filter.

    Parameters
    ----------
    settings : ChannelSettings
        Settings of the channel.
    """

    def __init__(self, settings: ChannelSettings) -> None:
        super().__init__(settings.limits)
        self._channel, self._across = Channel(settings), Channel(settings._replace(hole_sigma=np.inf))

    def gap(self, rows: int) -> None:
        """Advance by `rows` rows without a reading, as one step."""
        if rows:
            self._across_gap(rows)

    def _push(self, z: Floats, elapsed: Floats) -> tuple[tuple[Floats, Codes], Floats, Booleans]:
        estimates = self._channel.process(z, elapsed)
        gated = (estimates.verdict == Verdict.RUNAWAY) & np.isnan(
            estimates.innovation
        )  # RUNAWAY replaces the gate's verdict
        accepted = (estimates.verdict != Verdict.SPIKE) & ~gated
        return (estimates.signal, estimates.verdict), self._across.process(z, elapsed).signal, accepted


class ModesReference(_ControllerReference):
    """A reference for one channel with an IMM.

    Parameters
    ----------
    recipe : ChannelRecipe
        Recipe of the channel, in seconds and units.
    step_s : float
        Duration of a step, in seconds.
    """

    def __init__(self, recipe: ChannelRecipe, step_s: float) -> None:
        super().__init__(limits_of(recipe.limits))
        self._channel = open_live(recipe, step_s, 0)
        self._across = open_live(recipe.model_copy(update={"fill": True}), step_s, 0)

    def gap(self, rows: int) -> None:
        """Advance by `rows` rows without a reading: the first thousand one by one, all others as one step."""
        single = min(rows, _SINGLE)
        if single:
            self.run(np.full(single, np.nan))
        if rows > single:
            self._across_gap(rows - single)

    def _push(self, z: Floats, elapsed: Floats) -> tuple[tuple[Floats, Codes], Floats, Booleans]:
        rows, across = _push_joined(self._channel, z, elapsed), _push_joined(self._across, z, elapsed)
        return (rows.signal, rows.verdicts), across.signal, rows.verdicts != Verdict.SPIKE


def _push_joined(channel: LiveChannel, z: Floats, elapsed: Floats) -> EstimatedRows:
    return EstimatedRows.joined(channel.push(z, elapsed))
