"""Collect the mode probabilities of a stream's channels, in the order of the channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.arrays import Floats
from becalm.core.rows import EstimatedRows

NO_MODES: Floats = np.empty((0, 0))
"""Mode probabilities of a stream in which no channel has modes, for any number of rows."""


def count_modes(channel: ChannelRecipe) -> int:
    """Return the number of modes of a channel; 0 for a channel without modes."""
    return 0 if channel.switching is None or channel.motion is None else len(channel.switching.mode)


def with_modes(estimates: EstimatedRows, modes: int) -> list[EstimatedRows]:
    """Return saved rows with the probabilities of `modes` modes, or [] for no rows.

    The probabilities are NaN if an older version saved the rows without them.
    """
    if not len(estimates.signal):
        return []
    unknown = np.full((modes, len(estimates.signal)), np.nan)
    return [estimates if len(estimates.parts) == modes else estimates._replace(parts=unknown)]


def mode_probabilities(estimates: Mapping[int, EstimatedRows], modes: Sequence[int]) -> Floats:
    """Return the probabilities (R, K) of the modes of all channels, for R rows; (0, K) without rows.

    `estimates` has the number of the channel as key; `modes` has the number of modes of each channel.
    """
    if not any(modes):
        return NO_MODES
    if not estimates or not len(next(iter(estimates.values())).signal):
        return np.empty((0, sum(modes)))
    return np.concatenate([estimates[c].parts for c, count in enumerate(modes) if count]).T


def modes_in_handover(share: Floats, before: Floats, after: Floats) -> Floats:
    """Return mode probabilities (R, K) while a new filter replaces an old one; `share` is that of the new, (R, 1).

    A row has the probabilities of the filter with the larger share. Those of the old filter are NaN if the two filters
    have different numbers of modes.
    """
    if not after.shape[1]:
        return NO_MODES
    rows, modes = len(share), after.shape[1]
    former = before if before.shape == (rows, modes) else np.full((rows, modes), np.nan)
    later = np.concatenate([former[: rows - len(after)], after])
    return np.where(share < 0.5, former, later)
