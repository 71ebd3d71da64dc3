"""A map of how well every noise and density of a channel would foretell the next reading."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.cleaning.excerpt import ChannelRows
from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.steps import gate_of, in_steps
from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.identification.gating import forecasts
from becalm.identification.likelihood import UNSCORED, Evidence, Tuning
from becalm.identification.surface import surface

MOST_READINGS = 20_000

_STRETCHES = 4


class CostMap(NamedTuple):
    """A map about the setting of a channel."""

    noise_std: Floats  # (k,) in unit
    process_noise_density: Floats  # (l,) in unit^2/s^(2 order - 1)
    cost: Floats  # (k, l) in nats a reading, 0 at the best
    best: tuple[int, int]  # where that is: of the noises, of the densities
    here: tuple[float, float]  # the noise and the density that are set


def cost_map(rows: ChannelRows, channel: ChannelRecipe) -> CostMap:
    """Tell how much worse each noise and density foretells readings than the best of them.

    Parameters
    ----------
    rows : ChannelRows
        The channel's readings, of which 20 000 in whole stretches are looked at.
    channel : ChannelRecipe
        As it is set: the map is about its motion, whatever modes stand beside it.

    Raises
    ------
    UsageError
        If it passes unchanged, or too few readings come in a row.
    """
    if channel.motion is None:
        raise UsageError(f"{channel.name!r} passes unchanged; there is no noise and density to choose.")
    tuning = in_steps(channel.motion, rows.step_s)
    found = surface(tuning, _stretches(rows, channel, tuning))
    if found is None:
        raise UsageError("Too few readings come in a row to tell how well they are foretold.")
    best = np.unravel_index(int(np.argmin(found.cost)), found.cost.shape)
    return CostMap(
        found.noise_std,
        found.density / rows.step_s ** (2 * tuning.order - 1),
        found.cost,
        (int(best[0]), int(best[1])),
        (channel.motion.noise_std, channel.motion.process_noise_density),
    )


def _stretches(rows: ChannelRows, channel: ChannelRecipe, tuning: Tuning) -> list[Evidence]:
    """Return a few stretches of the readings, without what a gate leaves out."""
    readings, count = rows.healthy(channel.limits, None).readings, len(rows)
    length = MOST_READINGS if count <= MOST_READINGS else MOST_READINGS // _STRETCHES
    starts = [0] if count <= length else np.linspace(0, count - length, _STRETCHES).astype(int).tolist()
    gate = None if channel.gate is None else gate_of(channel.gate, rows.step_s)
    found = []
    for start in starts:
        part = slice(start, start + length)
        z = readings[part]
        if gate is not None:
            z = np.where(forecasts(tuning, z, rows.elapsed[part], gate).rejected, np.nan, z)
        whole = Evidence.of(z, rows.elapsed[part])
        found += [Evidence(whole.z[one], whole.elapsed[one]) for one in whole.stretches if len(whole.z[one]) > UNSCORED]
    return found
