"""Compute how well each pair of noise and process noise density predicts a channel's readings."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.cleaning.channels.excerpt import ChannelRows
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.steps import gate_of, in_steps
from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.identification.gating import forecasts
from becalm.identification.likelihood import UNSCORED, Evidence, Tuning
from becalm.identification.likelihood_surface import surface

MOST_READINGS = 20_000  # largest number of rows that a map uses

_STRETCHES = 4  # number of stretches that a map uses of a longer record


class CostMap(NamedTuple):
    """A map of the prediction cost around the setting of a channel."""

    noise_std: Floats  # (k,) in unit
    process_noise_density: Floats  # (l,) in unit^2/s^(2 order - 1)
    cost: Floats  # (k, l) in nats per reading, 0 at the minimum
    best: tuple[int, int]  # indices of the minimum: of the noise, of the density
    here: tuple[float, float]  # noise and density of the present setting, in the same units


def cost_map(rows: ChannelRows, channel: ChannelRecipe) -> CostMap:
    """Compute how much worse each pair of noise and density predicts readings than the best pair.

    Parameters
    ----------
    rows : ChannelRows
        Readings of the channel; of a long record the map uses four stretches of 5000 rows.
    channel : ChannelRecipe
        Present setting. The map includes tones and coloured noise, which scale with the noise, but not further modes.

    Raises
    ------
    UsageError
        If the channel passes unchanged, or has too few readings without a gap.
    """
    if channel.motion is None:
        raise UsageError(f"{channel.name!r} passes unchanged; it has no noise and density to choose.")
    tuning = in_steps(channel.motion, rows.step_s)
    grid = surface(tuning, _stretches(rows, channel, tuning))
    if grid is None:
        raise UsageError("Too few readings without a gap to compute how well they are predicted.")
    best = np.unravel_index(int(np.argmin(grid.cost)), grid.cost.shape)
    return CostMap(
        grid.noise_std,
        grid.density / rows.step_s ** (2 * tuning.order - 1),
        grid.cost,
        (int(best[0]), int(best[1])),
        (channel.motion.noise_std, channel.motion.process_noise_density),
    )


def _stretches(rows: ChannelRows, channel: ChannelRecipe, tuning: Tuning) -> list[Evidence]:
    """Return a few stretches of a channel; readings that the gate rejects are missing."""
    readings, count = rows.healthy(channel.limits, None).readings, len(rows)
    length = MOST_READINGS if count <= MOST_READINGS else MOST_READINGS // _STRETCHES
    starts = [0] if count <= length else np.linspace(0, count - length, _STRETCHES).astype(int).tolist()
    gate = None if channel.gate is None else gate_of(channel.gate, rows.step_s)
    stretches = []
    for start in starts:
        part = slice(start, start + length)
        z = readings[part]
        if gate is not None:
            z = np.where(forecasts(tuning, z, rows.elapsed[part], gate).rejected, np.nan, z)
        whole = Evidence.of(z, rows.elapsed[part])
        long = [one for one in whole.stretches if len(whole.z[one]) > UNSCORED]
        stretches += [Evidence(whole.z[one], whole.elapsed[one]) for one in long]
    return stretches
