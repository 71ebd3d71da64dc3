"""How well every noise and density of a motion would foretell the next reading: a map of the likelihood.

Of one ratio q/r the filter's gains are the same whatever r is; with the squares and determinants of a pass with r = 1

    NLL(r) / N = 1/2 (log 2 pi + mean log S + log r + mean(nu^2 / S) / r)

so that a pass a ratio is enough for all cells of a diagonal. What stands beside the motion is carried along in
proportion to r.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.steps import gate_of, in_steps
from becalm.core.arrays import Floats
from becalm.core.components import motion
from becalm.core.filtering import Sums
from becalm.core.likelihood import score
from becalm.core.timeline import Timeline, elapsed_timeline
from becalm.errors import UsageError
from becalm.noise.gating import forecasts
from becalm.noise.likelihood import UNSCORED, Evidence, Tuning
from becalm.web.tuner.rows import ChannelRows

MOST_READINGS = 20_000

_STRETCHES = 4
_NOISES, _DENSITIES = 41, 61
_NOISE_DECADES = 2.0  # of the standard deviation, to each side
_FEWEST = 8
_STILL = 1e-9  # q/r that a map is drawn about where a filter believes in no change at all


class CostMap(NamedTuple):
    """A map about the setting of a channel."""

    noise_std: Floats  # (k,) in unit
    process_noise_density: Floats  # (l,)
    cost: Floats  # (k, l) in nats a reading, 0 at the best
    best: tuple[int, int]
    here: tuple[float, float]


def cost_map(rows: ChannelRows, channel: ChannelRecipe) -> CostMap:
    """Tell how much worse each noise and density foretells readings than the best of them.

    Parameters
    ----------
    rows : ChannelRows
        The channel's readings, of which 20 000 in whole stretches are looked at.
    channel : ChannelRecipe
        As it is set: the map is about its motion.

    Raises
    ------
    UsageError
        If it passes unchanged, switches, or too few readings are there.
    """
    if channel.motion is None:
        raise UsageError(f"{channel.name!r} passes unchanged; there is no noise and density to choose.")
    tuning = in_steps(channel.motion, rows.step_s)
    density = channel.motion.process_noise_density or _STILL * tuning.noise_variance / rows.step_s ** (
        2 * tuning.order - 1
    )
    ratio = tuning.ratio or _STILL
    decades = _NOISE_DECADES * np.linspace(-1.0, 1.0, _NOISES)
    step = 2 * float(decades[1] - decades[0])  # of the variance: as of the densities, so that ratios are diagonals
    powers = step * (np.arange(_DENSITIES) - _DENSITIES // 2)
    passes = _Passes(tuning, _stretches(rows, channel, tuning))
    least = step * -(_NOISES // 2 + _DENSITIES // 2)
    sums = [passes.sums(ratio * 10.0 ** (least + step * k)) for k in range(_NOISES + _DENSITIES - 1)]
    r = tuning.noise_variance * 10.0 ** (2 * decades)
    of_ratio = np.arange(_DENSITIES)[np.newaxis, :] - np.arange(_NOISES)[:, np.newaxis] + _NOISES - 1
    squares, log_det, used = (np.array([one[place] for one in sums], dtype=float)[of_ratio] for place in range(3))
    if not used.max() >= _FEWEST:
        raise UsageError("Too few readings come in a row to tell how well they are foretold.")
    with np.errstate(divide="ignore", invalid="ignore"):
        cost = 0.5 * ((log_det + squares / r[:, np.newaxis]) / used + np.log(r)[:, np.newaxis])
    cost = np.where(used > 0, cost, np.inf)
    best = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return CostMap(
        np.asarray(channel.motion.noise_std * 10.0**decades),
        np.asarray(density * 10.0**powers),
        cost - cost.min(),
        (int(best[0]), int(best[1])),
        (channel.motion.noise_std, channel.motion.process_noise_density),
    )


class _Passes:
    """Filters stretches of readings with any ratio q/r, and r = 1."""

    def __init__(self, tuning: Tuning, stretches: list[Evidence]) -> None:
        r, noise = tuning.noise_variance, tuning.coloured
        unit = replace(
            tuning,
            ratio=1.0,
            noise_variance=1.0,
            lines=tuple(line._replace(density=line.density / r) for line in tuning.lines),
            coloured=None if noise is None else noise._replace(variance=noise.variance / r),
        )
        component = unit.component
        still = sum(unit.companions, motion(tuning.order, 0.0))
        self._model = component.to_model(1.0, 1.0)
        self._stretches: list[tuple[Timeline, Floats, Floats]] = []
        for evidence in stretches:
            timeline = elapsed_timeline(component, 1.0, evidence.elapsed)
            beside = elapsed_timeline(still, 1.0, evidence.elapsed).system.Q
            self._stretches.append((timeline, beside, evidence.z))

    def sums(self, ratio: float) -> tuple[float, float, int]:
        """Return the sums of nu^2 / S and log S, and how many readings they are of."""
        total = Sums()
        for timeline, beside, z in self._stretches:
            system = timeline.system
            scaled = system._replace(Q=beside + ratio * (system.Q - beside))
            total = total.plus(score(self._model, timeline._replace(system=scaled), z, UNSCORED) or Sums())
        return total[0], total[1], total[2]


def _stretches(rows: ChannelRows, channel: ChannelRecipe, tuning: Tuning) -> list[Evidence]:
    """Return a few stretches of the readings, without what a gate leaves out."""
    readings, count = rows.healthy(channel.limits).readings, len(rows)
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
