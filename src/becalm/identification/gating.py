"""Decide whether a channel gets an innovation gate, and tune the channel if its readings contain spikes.

Spikes inflate the identified noise, and the gate then rejects too few of them. Therefore a channel is tuned and gated,
and then tuned again without the rejected readings, until these no longer change.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Floats, input_of
from becalm.core.filter.channel import Channel
from becalm.core.filter.channel_settings import ChannelSettings
from becalm.core.filter.gate import Gate
from becalm.core.reading_verdicts import Verdict
from becalm.identification.choose import NOTHING_KNOWN, Choice, PriorKnowledge, choose
from becalm.identification.imputation import imputed
from becalm.identification.likelihood import Tuning
from becalm.identification.modes.banks import rejects_stand_out

ROUNDS = 12
"""Largest number of tunings. Each reduces the noise that huge spikes add, by a factor of the root of their share."""

MOST_REJECTED = 0.05
"""Largest share of readings that a gate may reject; more rejected readings are no exceptions."""

FEWEST_ISOLATED = 0.5
"""Least share of the rejected readings that must be isolated or in pairs."""

SHOULDER, MOST_NEAR = 0.7, 0.5
"""Lower end of the shoulder, as a share of the threshold; most innovations in it, as a share of the rejected readings.

The shoulder is the range of innovations just below the gate's threshold. Only the innovations beyond the number that
Gaussian noise has there count. Spikes leave fewer than `MOST_NEAR`, heavy tails at least twice as many.
"""

DOUBT = 3.0
"""Largest loss in log-likelihood with which a gate is still accepted; a smaller difference may be due to chance."""

_LEAST_SCALE = 1e-6  # least factor of the noise's standard deviation, for readings more than half of which are equal
_MIDDLE = 1.4826  # standard deviation of Gaussian noise over the median of its magnitude
_CHANCE = 3.0  # standard deviations by which a count may exceed its expectation
_SAME = 0.1  # relative change of a noise variance at which the iteration ends
_PAIR = 2  # longest run of rejects that are isolated or in a pair
_PIECE = 1 << 15  # rows filtered at once; with uneven sampling each row has its own step matrices


class GatedChoice(NamedTuple):
    """The identified model of one channel, and whether to use a gate with it."""

    choice: Choice
    gated: bool


class Forecasts(NamedTuple):
    """One-step predictions of a causal filter compared with the readings."""

    normalised: Floats  # (N,) innovations over their standard deviations; NaN where a reading was not used
    sigma: Floats  # (N,) those standard deviations, in unit
    rejected: Booleans  # (N,) True for the readings that the gate rejected

    def log_densities(self) -> Floats:
        """Return the log-likelihood (N,) of each reading, up to a constant."""
        return -0.5 * self.normalised**2 - np.log(self.sigma)


def choose_gated(
    readings: Floats, elapsed: Floats, gate: Gate, causal: bool = True, known: PriorKnowledge = NOTHING_KNOWN
) -> GatedChoice:
    """Identify the noise of one channel, choose its motion, and decide whether it gets a gate.

    Parameters
    ----------
    readings : (N,) float array
        Measurements in the channel's unit, NaN where missing.
    elapsed : (N,) float array
        Time since the previous row, in steps.
    gate : Gate
        The gate to try.
    causal : bool
        True tunes a causal filter, False a smoother.
    known : PriorKnowledge
        Noise and tones that are known, and therefore not identified.

    Returns
    -------
    GatedChoice
        The choice; it is that of `choose` if the gate is not used or rejects nothing.

    Raises
    ------
    RecordingError, ModelError
        As `choose` does.

    Notes
    -----
    Before each run with the gate, r is reduced if the median innovation is smaller than expected; otherwise the noise
    that spikes add would keep the spikes within the threshold. The gate is used only if it does not make the
    predictions of the accepted readings worse. An accepted spike makes the predictions after it worse, and so does
    rejected motion.
    """
    plain = choice = choose(readings, elapsed, causal, known)
    before, variance = np.zeros(len(readings), dtype=bool), np.inf
    for _ in range(ROUNDS - 1):
        if choice.tuning is None:
            return GatedChoice(plain, False)
        tuning = with_robust_noise(choice.tuning, readings, elapsed)
        predictions = forecasts(tuning, readings, elapsed, gate)
        rejected = predictions.rejected
        if not _are_exceptions(rejected, readings) or has_shoulders(predictions, gate.threshold):
            return GatedChoice(plain, False)
        settled = abs(tuning.noise_variance - variance) < _SAME * variance and np.array_equal(rejected, before)
        if settled or not rejected.any():
            break
        choice = choose(imputed(tuning, readings, elapsed, rejected), elapsed, causal, known)
        before, variance = rejected, tuning.noise_variance
    if choice.tuning is None or (choice is not plain and not predicts_better(choice.tuning, readings, elapsed, gate)):
        return GatedChoice(plain, False)
    return GatedChoice(choice, True)


def predicts_better(tuning: Tuning, readings: Floats, elapsed: Floats, gate: Gate) -> bool:
    """Return whether a filter with a gate predicts the accepted readings better than a filter without one."""
    gated, free = (forecasts(tuning, readings, elapsed, how) for how in (gate, None))
    if not _are_exceptions(gated.rejected, readings) or has_shoulders(gated, gate.threshold):
        return False
    gain = gated.log_densities() - free.log_densities()
    return bool(np.nansum(gain) >= -DOUBT)


def has_shoulders(predictions: Forecasts, threshold: float) -> bool:
    """Return whether more innovations lie just below the threshold than Gaussian noise and spikes explain.

    If so, the rejected readings are not spikes, but the ends of heavy tails.
    """
    from scipy.special import ndtr

    seen = np.abs(predictions.normalised[np.isfinite(predictions.normalised)])
    near = np.count_nonzero((seen > SHOULDER * threshold) & (seen <= threshold))
    expected = 2 * len(seen) * float(ndtr(-SHOULDER * threshold) - ndtr(-threshold))
    rejected = np.count_nonzero(predictions.rejected)
    return bool(rejected and near > expected + MOST_NEAR * rejected + _CHANCE * np.sqrt(expected + 1))


def forecasts(tuning: Tuning, readings: Floats, elapsed: Floats, gate: Gate | None) -> Forecasts:
    """Predict readings (N,) causally, with or without a gate."""
    channel = Channel(ChannelSettings(tuning.component, tuning.noise_variance, gate=gate))
    readings, elapsed = input_of(readings), input_of(elapsed)
    pieces = (slice(start, start + _PIECE) for start in range(0, len(readings), _PIECE))
    estimates = [channel.process(readings[piece], elapsed[piece]) for piece in pieces]
    nu, sigma = (
        np.concatenate(parts) for parts in zip(*((one.innovation, one.deviation) for one in estimates), strict=True)
    )
    rejected = np.concatenate([one.verdict for one in estimates]) == Verdict.SPIKE
    return Forecasts(nu / sigma, sigma, rejected)


def with_robust_noise(tuning: Tuning, readings: Floats, elapsed: Floats) -> Tuning:
    """Return a tuning whose r is reduced to what the median innovation shows; spikes hardly change a median."""
    free = np.abs(forecasts(tuning, readings, elapsed, None).normalised)
    seen = free[np.isfinite(free)]
    scale = min(1.0, max(_LEAST_SCALE, _MIDDLE * float(np.median(seen)))) if len(seen) else 1.0
    return replace(tuning, noise_variance=tuning.noise_variance * scale**2)


def _are_exceptions(rejected: Booleans, readings: Floats) -> bool:
    """Return whether the rejected readings are few, mostly isolated or paired, and stand out from their neighbours."""
    count, seen = np.count_nonzero(rejected), np.count_nonzero(np.isfinite(readings))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rejected, [False]]).astype(np.int8)))
    lengths = np.diff(edges)[::2]
    isolated = int(lengths[lengths <= _PAIR].sum())
    few = count <= MOST_REJECTED * seen and isolated >= FEWEST_ISOLATED * count
    return bool(few and rejects_stand_out(readings, rejected))
