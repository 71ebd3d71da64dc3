"""Compare the errors of an IMM smoother and a fixed smoother without the truth."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Booleans, Floats
from becalm.core.filter.smoothed_flow import SmoothedFlow
from becalm.core.imm.flow import ImmFlow
from becalm.core.imm.modes import InteractingModels, numbered_steps
from becalm.identification.likelihood import Evidence, Tuning
from becalm.identification.risk import estimated_risk, long_pieces
from becalm.native.imm import NOTHING_WANTED, filter_rows, new_state

_LESS = 0.05  # relative reduction of the mean squared error that an IMM smoother needs
_CLEARLY = 3.0  # standard errors by which it is better beyond doubt
_FAR_LESS = 0.1  # share of the fixed smoother's risk below which hidden readings may contradict, within ...
_BY_CHANCE = 2.0  # ... so many standard errors: one reading of a shock, which nothing predicts, makes one of them
_HIDDEN = 10  # every tenth reading is hidden from the smoothers
_PROBE = 0.02  # of a standard deviation of the noise
_LIKELY = 0.5  # probability from which a reading is taken for an outlier
_ROWS_AT_ONCE = 1 << 15  # rows


def find_wild(switching: InteractingModels, readings: Floats, elapsed: Floats) -> Booleans:
    """Return which readings (N,) the causal IMM filter takes for outliers."""
    wild = np.zeros(len(readings))
    state = new_state(switching.bank(np.ones(1)), keeps_level=False)
    for start in range(0, len(readings), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        lengths, steps = numbered_steps(elapsed[rows])
        trace = NOTHING_WANTED._replace(wild=wild[rows])
        filter_rows(switching.bank(lengths), state, np.ascontiguousarray(readings[rows]), steps, trace)
    outliers: Booleans = wild > _LIKELY
    return outliers


def _without_outliers(switching: InteractingModels, evidence: Evidence) -> Evidence:
    """Return evidence with each outlier replaced by a draw from the IMM smoother's estimate."""
    if not switching.rejects:
        return evidence
    z, noise = evidence.z[:, 0].copy(), switching.least_noise_variance
    wild = find_wild(switching, z, evidence.elapsed)
    if not wild.any():
        return evidence
    smooth = _smoothed(ImmFlow(switching, causal=False), z, evidence.elapsed)
    z[wild] = smooth[wild] + np.sqrt(noise) * np.random.default_rng(len(z)).normal(size=int(wild.sum()))
    return Evidence.of(z, evidence.elapsed)


def errs_less(switching: InteractingModels, tuning: Tuning, evidence: Evidence) -> bool:
    """Return whether an IMM smoother errs less than the fixed one, clearly at hidden readings or by its estimated risk.

    Where a record rests, the small gain is lost in the noise of hidden readings. Then the risk decides, and the hidden
    readings may contradict it only by chance: by one standard error, or by two where the gain in risk is large. The
    risk needs the variance of the noise; of the two variances the smaller is used. Hidden readings need none. Outliers
    say nothing about errors, so draws from the IMM's estimate replace them.
    """
    evidence = _without_outliers(switching, evidence)
    fixed_flow = SmoothedFlow(tuning.component, tuning.noise_variance)
    more = hidden_errors(ImmFlow(switching, causal=False), evidence) - hidden_errors(fixed_flow, evidence)
    if not len(more):
        return False
    chance = float(more.std()) / np.sqrt(len(more))
    if more.mean() < -_CLEARLY * chance:
        return True
    R = min(tuning.noise_variance, switching.least_noise_variance)
    fixed = estimated_risk(tuning, evidence, R, causal=False).error
    share = _FAR_LESS if more.mean() > chance else 1 - _LESS
    return bool(more.mean() <= _BY_CHANCE * chance and _risk(switching, evidence, R) < share * fixed)


def hidden_errors(flow: SmoothedFlow | ImmFlow, evidence: Evidence) -> Floats:
    """Return the squared errors of a smoother at every tenth reading, which is hidden from it; none if few."""
    part = max(long_pieces(evidence), key=lambda piece: piece.stop - piece.start)
    z, elapsed = evidence.z[part, 0], evidence.elapsed[part]
    hidden = np.arange(len(z)) % _HIDDEN == _HIDDEN // 2
    return np.asarray((_smoothed(flow, np.where(hidden, np.nan, z), elapsed) - z)[hidden] ** 2)


def _risk(switching: InteractingModels, evidence: Evidence, noise_variance: float) -> float:
    """Estimate the mean squared error of an IMM smoother from its response to a small probe."""
    squares, responses, count = 0.0, 0.0, 0
    size = _PROBE * float(np.sqrt(noise_variance))
    for part in long_pieces(evidence):
        z, elapsed = evidence.z[part, 0], evidence.elapsed[part]
        probe = np.random.default_rng(len(z)).choice([-1.0, 1.0], len(z))
        smooth, response = (
            _smoothed(ImmFlow(switching, causal=False), read, elapsed) for read in (z, z + size * probe)
        )
        squares += float(np.sum((z - smooth) ** 2))
        responses += float(np.sum(probe * (response - smooth))) / size
        count += len(z)
    return squares / count + noise_variance * (2 * responses / count - 1)


def _smoothed(flow: SmoothedFlow | ImmFlow, z: Floats, elapsed: Floats) -> Floats:
    return np.concatenate([estimate.signal for estimate in [*flow.push(z, elapsed), *flow.finish()]])
