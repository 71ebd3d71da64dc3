"""Whether a channel gets a gate; and its tuning, where spikes are in the readings.

Spikes inflate the noise, and a tuning that believes them rejects too few; so a channel is tuned, gated and
tuned again on what was not rejected. Whether the rejects were spikes is told by the readings after them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Floats, input_of
from becalm.core.filter.channel import Channel
from becalm.core.filter.channel_settings import ChannelSettings
from becalm.core.filter.gate import Gate
from becalm.core.verdict import Verdict
from becalm.identification.choose import NOTHING_KNOWN, Choice, PriorKnowledge, choose
from becalm.identification.imputation import imputed
from becalm.identification.likelihood import Tuning
from becalm.identification.modes.rejection import stand_out

ROUNDS = 12
"""Tunings at the most: each lowers what huge spikes feign by the root of their share, until nothing changes."""

MOST_REJECTED = 0.05
"""Share of the readings beyond which rejects are no exceptions."""

FEWEST_ISOLATED = 0.5
"""Share of the rejects that have to stand alone, or in pairs."""

SHOULDER, MOST_NEAR = 0.7, 0.5
"""Of the threshold: innovations from there on, beyond those of Gaussian noise, are fewer than this share of the
rejects where these are spikes. Heavy tails have twice as many and more."""

DOUBT = 3.0
"""Log-likelihood that a gate may seem to cost: of a filter that hardly believes a reading only chance tells."""

_LEAST_SCALE = 1e-6  # where more than half of the readings are equal
_MIDDLE = 1.4826  # of the median of |e|, which makes a standard deviation of Gaussian noise
_CHANCE = 3.0  # standard deviations of a count
_SAME = 0.1  # of a noise variance: another round would change little
_PAIR = 2
_PIECE = 1 << 15  # rows that are filtered at once: in uneven time each has step matrices of its own


class GatedChoice(NamedTuple):
    """What was found for one channel, and whether a gate goes with it."""

    choice: Choice
    gated: bool


class Forecasts(NamedTuple):
    """How a causal filter foretold readings."""

    normalised: Floats  # (N,) innovations over their standard deviations; NaN where a reading was not used
    sigma: Floats  # (N,) those standard deviations
    rejected: Booleans  # (N,)

    def log_densities(self) -> Floats:
        """Return the log-likelihood (N,) of each reading, but for a constant."""
        return -0.5 * self.normalised**2 - np.log(self.sigma)


def choose_gated(
    readings: Floats, elapsed: Floats, gate: Gate, causal: bool = True, known: PriorKnowledge = NOTHING_KNOWN
) -> GatedChoice:
    """Identify the noise of one channel, choose its motion, and decide whether a gate goes with it.

    Parameters
    ----------
    readings : (N,) float array
        In the channel's unit, NaN where missing.
    elapsed : (N,) float array
        Steps since the row before.
    gate : Gate
        What it would be.
    causal : bool
        Whether the filter shall run causally.
    known : PriorKnowledge
        What need not be found.

    Returns
    -------
    GatedChoice
        Without a gate, or where it rejects nothing, the choice is that of `choose`.

    Raises
    ------
    RecordingError, ModelError
        As `choose` does.

    Notes
    -----
    With q and r scaled down where the middle half of the innovations is narrower than expected, spikes
    cannot hide behind the noise that they feign. The gate stays where what was used is foretold the better
    for it: a spike that is believed spoils the forecasts after it, and motion that is not believed does.
    """
    plain = choice = choose(readings, elapsed, causal, known)
    before, variance = np.zeros(len(readings), dtype=bool), np.inf
    for _ in range(ROUNDS - 1):
        if choice.tuning is None:
            return GatedChoice(plain, False)
        tuning = robust(choice.tuning, readings, elapsed)
        found = forecasts(tuning, readings, elapsed, gate)
        rejected = found.rejected
        if not _are_exceptions(rejected, readings) or has_shoulders(found, gate.threshold):
            return GatedChoice(plain, False)
        settled = abs(tuning.noise_variance - variance) < _SAME * variance and np.array_equal(rejected, before)
        if settled or not rejected.any():
            break
        choice = choose(imputed(tuning, readings, elapsed, rejected), elapsed, causal, known)
        before, variance = rejected, tuning.noise_variance
    if choice.tuning is None or (choice is not plain and not foretells_better(choice.tuning, readings, elapsed, gate)):
        return GatedChoice(plain, False)
    return GatedChoice(choice, True)


def foretells_better(tuning: Tuning, readings: Floats, elapsed: Floats, gate: Gate) -> bool:
    """Whether a filter with a gate foretells the readings that it uses better than one that believes all of them."""
    gated, free = (forecasts(tuning, readings, elapsed, how) for how in (gate, None))
    if not _are_exceptions(gated.rejected, readings) or has_shoulders(gated, gate.threshold):
        return False
    gain = gated.log_densities() - free.log_densities()
    return bool(np.nansum(gain) >= -DOUBT)


def has_shoulders(found: Forecasts, threshold: float) -> bool:
    """Whether innovations are heavier than Gaussian below the threshold too: rejects are no kind of their own then."""
    from scipy.special import ndtr

    seen = np.abs(found.normalised[np.isfinite(found.normalised)])
    near = np.count_nonzero((seen > SHOULDER * threshold) & (seen <= threshold))
    expected = 2 * len(seen) * float(ndtr(-SHOULDER * threshold) - ndtr(-threshold))
    rejected = np.count_nonzero(found.rejected)
    return bool(rejected and near > expected + MOST_NEAR * rejected + _CHANCE * np.sqrt(expected + 1))


def forecasts(tuning: Tuning, readings: Floats, elapsed: Floats, gate: Gate | None) -> Forecasts:
    """Foretell readings (N,), causally, with a gate or without."""
    channel = Channel(ChannelSettings(tuning.component, tuning.noise_variance, gate=gate))
    readings, elapsed = input_of(readings), input_of(elapsed)
    pieces = (slice(start, start + _PIECE) for start in range(0, len(readings), _PIECE))
    found = [channel.process(readings[piece], elapsed[piece]) for piece in pieces]
    nu, sigma = (
        np.concatenate(parts) for parts in zip(*((one.innovation, one.deviation) for one in found), strict=True)
    )
    rejected = np.concatenate([one.verdict for one in found]) == Verdict.SPIKE
    return Forecasts(nu / sigma, sigma, rejected)


def robust(tuning: Tuning, readings: Floats, elapsed: Floats) -> Tuning:
    """Return a tuning whose noise is no wider than the middle half of the innovations says, which no spike moves."""
    free = np.abs(forecasts(tuning, readings, elapsed, None).normalised)
    seen = free[np.isfinite(free)]
    scale = min(1.0, max(_LEAST_SCALE, _MIDDLE * float(np.median(seen)))) if len(seen) else 1.0
    return replace(tuning, noise_variance=tuning.noise_variance * scale**2)


def _are_exceptions(rejected: Booleans, readings: Floats) -> bool:
    """Return whether rejects are few, and most of them stand alone or in pairs, out of their neighbours."""
    count, seen = np.count_nonzero(rejected), np.count_nonzero(np.isfinite(readings))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rejected, [False]]).astype(np.int8)))
    lengths = np.diff(edges)[::2]
    alone = int(lengths[lengths <= _PAIR].sum())
    few = count <= MOST_REJECTED * seen and alone >= FEWEST_ISOLATED * count
    return bool(few and stand_out(readings, rejected))
