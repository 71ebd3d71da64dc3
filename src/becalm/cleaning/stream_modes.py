"""How probable the modes of a stream's channels are: those of all that switch, one channel after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.core.rows import EstimatedRows

NO_MODES: Floats = np.empty((0, 0))
"""What is told where no channel switches, of any number of rows."""


def modes_in(channel: ChannelRecipe) -> int:
    """Return how many modes a channel switches between; 0 of one that does not."""
    return 0 if channel.switching is None or channel.motion is None else len(channel.switching.mode)


def with_modes(told: EstimatedRows, modes: int) -> list[EstimatedRows]:
    """Return rows that wait with so many modes, if any wait; of those that an older becalm kept none is known."""
    unknown = np.full((modes, len(told.signal)), np.nan)
    return [told if len(told.parts) == modes else told._replace(parts=unknown)] if len(told.signal) else []


def modes_of(told: Mapping[int, EstimatedRows], modes: Sequence[int]) -> Floats:
    """Return (R, K) of rows of channels that have so many modes each; no channel is no row."""
    if not any(modes):
        return NO_MODES
    if not told or not len(next(iter(told.values())).signal):
        return np.empty((0, sum(modes)))
    return np.concatenate([told[c].parts for c, some in enumerate(modes) if some]).T


def handed_over(share: Floats, before: Floats, after: Floats) -> Floats:
    """Return probabilities (R, K) while one filter gives way to another, whose share is (R, 1) of each row.

    They are those of the filter that is told more; where the two have other modes, only the later one's are known.
    """
    if not after.shape[1]:
        return NO_MODES
    rows, modes = len(share), after.shape[1]
    former = before if before.shape == (rows, modes) else np.full((rows, modes), np.nan)
    later = np.concatenate([former[: rows - len(after)], after])
    return np.where(share < 0.5, former, later)
