"""Whether a smoother that switches errs less than one that does not, without the truth."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Booleans, Floats
from becalm.core.filter.smoothed_flow import SmoothedFlow
from becalm.core.imm.flow import ImmFlow
from becalm.core.imm.modes import InteractingModels, numbered_steps
from becalm.identification.likelihood import Evidence, Tuning
from becalm.identification.risk import estimated_risk, long_pieces
from becalm.native.imm import NOTHING_WANTED, filter_rows, new_state

_LESS = 0.05  # of a mean squared error, by which a smoother that switches must err less
_CLEARLY = 3.0  # standard errors, by which it does beyond doubt
_FAR_LESS, _BY_CHANCE = 0.1, 2.0  # of a fixed smoother's risk: beside it hidden readings may contradict by so many, for
# one of a shock, which nothing foretells, makes one of them alone
_HIDDEN = 10  # every such reading is hidden from smoothers that are compared
_PROBE = 0.02  # of a standard deviation of the noise
_LIKELY = 0.5  # probability from which a reading is taken for a wild one
_PIECE = 1 << 15  # rows


def find_wild(switching: InteractingModels, readings: Floats, elapsed: Floats) -> Booleans:
    """Tell which readings (N,) a filter took for wild, as they came."""
    wild = np.zeros(len(readings))
    state = new_state(switching.bank(np.ones(1)), keeps_level=False)
    for start in range(0, len(readings), _PIECE):
        rows = slice(start, start + _PIECE)
        lengths, steps = numbered_steps(elapsed[rows])
        trace = NOTHING_WANTED._replace(wild=wild[rows])
        filter_rows(switching.bank(lengths), state, np.ascontiguousarray(readings[rows]), steps, trace)
    told: Booleans = wild > _LIKELY
    return told


def _tame(switching: InteractingModels, evidence: Evidence) -> Evidence:
    """Return evidence with draws of what a bank believes in place of the readings that it takes for wild."""
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
    """Whether a smoother that switches errs less than the fixed one: clearly where readings are hidden, or by its risk.

    What little is gained where a record rests drowns in the noise of hidden readings; then the risk tells it, and
    hidden readings have to contradict by no more than chance: one standard error, or two where it tells much. The risk
    needs the variance of the noise, and of two it takes the smaller; hidden readings need none.
    Readings that the bank takes for wild say nothing of errors; draws of what it believes stand in their place.
    """
    evidence = _tame(switching, evidence)
    alone = SmoothedFlow(tuning.component, tuning.noise_variance)
    more = hidden_errors(ImmFlow(switching, causal=False), evidence) - hidden_errors(alone, evidence)
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
    """Return the squared errors of a smoother at every tenth reading, which it is not shown; none of few readings."""
    part = max(long_pieces(evidence), key=lambda piece: piece.stop - piece.start)
    z, elapsed = evidence.z[part, 0], evidence.elapsed[part]
    hidden = np.arange(len(z)) % _HIDDEN == _HIDDEN // 2
    return np.asarray((_smoothed(flow, np.where(hidden, np.nan, z), elapsed) - z)[hidden] ** 2)


def _risk(switching: InteractingModels, evidence: Evidence, noise_variance: float) -> float:
    """Estimate the mean squared error of a smoother that switches, by how it answers a small probe."""
    squares, answers, count = 0.0, 0.0, 0
    size = _PROBE * float(np.sqrt(noise_variance))
    for part in long_pieces(evidence):
        z, elapsed = evidence.z[part, 0], evidence.elapsed[part]
        probe = np.random.default_rng(len(z)).choice([-1.0, 1.0], len(z))
        smooth, answer = (_smoothed(ImmFlow(switching, causal=False), read, elapsed) for read in (z, z + size * probe))
        squares += float(np.sum((z - smooth) ** 2))
        answers += float(np.sum(probe * (answer - smooth))) / size
        count += len(z)
    return squares / count + noise_variance * (2 * answers / count - 1)


def _smoothed(flow: SmoothedFlow | ImmFlow, z: Floats, elapsed: Floats) -> Floats:
    return np.concatenate([told.signal for told in [*flow.push(z, elapsed), *flow.finish()]])
