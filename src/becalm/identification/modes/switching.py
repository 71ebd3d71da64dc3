"""Modes found from a recording: a filter that switches, where it foretells the readings better than a fixed one.

Five banks are tried, each with few numbers, which are searched by likelihood (`banks`). A number leaves its
default only where the record clearly says so, so that a record that shows few switches still gets a bank that
follows any. A smoother has to err less as well, clearly at hidden readings or by its estimated risk: what foretells
best need not smooth best.
Source of that estimate for filters that are not linear: Ramani, Blu and Unser, IEEE TIP-17 (2008) 1540.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.imm.modes import InteractingModels, Mode
from becalm.core.model.components import ORDERS, with_walking_level
from becalm.identification.damping import damped
from becalm.identification.likelihood import Evidence, Tuning, tune_motion
from becalm.identification.modes.bank_risk import errs_less, find_wild
from becalm.identification.modes.banks import (
    EvidencePiece,
    ImmFamily,
    Kind,
    jumping,
    log_likelihood,
    noisy,
    pieces_of,
    resting,
    searched,
    spiky,
)
from becalm.identification.modes.bursts import find_bursting
from becalm.identification.modes.rejection import stand_out

_FEWEST = 256  # readings, below which no switch can be told from noise
_SURPRISING = 6.0  # standard deviations: a difference of means that Gaussian noise and motion do not make
_BETTER = 6.0  # of a log-likelihood, for which a filter that switches is taken
_DOUBT = 15.0  # of it, which levels that jump may seem to cost: about what one switch does
_MOTION_FIRST = 45.0  # of it, by which loud noise must be likelier than motion: more than a shock of 100 readings


@dataclass(frozen=True)
class Switched:
    """A bank, and how well it foretells.

    Attributes
    ----------
    kind : {"resting", "jumping", "noisy", "spiky", "bursting"}
        See `becalm.identification.modes.banks`.
    switching : InteractingModels
        The modes, in steps.
    log_likelihood : float
        Of the readings that banks were compared on.
    fixed_log_likelihood : float
        Of the best fixed filter, on the same readings.
    tuning : Tuning
        The fixed filter that goes with it, perhaps with tones.
    """

    kind: Kind
    switching: InteractingModels
    log_likelihood: float
    fixed_log_likelihood: float
    tuning: Tuning


def find_switching(
    tuning: Tuning, evidence: Evidence, causal: bool, spikes_gated: bool = False, wild: Evidence | None = None
) -> Switched | None:
    """Find the bank that foretells a record best; None where a fixed filter does as well.

    Parameters
    ----------
    tuning : Tuning
        The fixed filter that was chosen, perhaps with tones.
    evidence : Evidence
        The readings it was tuned on, all of them.
    causal : bool
        Whether it shall filter (True) or smooth.
    spikes_gated : bool
        Whether a gate leaves spikes out of the fixed filter; then a bank has to be better than that.
    wild : Evidence, optional
        The readings with the gross outliers that stand before every filter: they tell a causal bank how seldom a
        reading that is far off is a jump. A smoother's outliers are found on both sides, and hardly any is left.
    """
    surprise = find_surprise(evidence.z[:, 0]) if len(evidence.z) >= _FEWEST else None
    if surprise is None:
        return None
    pieces, motions = pieces_of(evidence, surprise), [tune_motion(order, evidence) for order in ORDERS]
    likeliest = damped(max(motions, key=lambda motion: motion.log_likelihood), evidence)
    fixed = max(log_likelihood(_alone(one), pieces) for one in (tuning, likeliest))
    bursts = find_bursting(likeliest, evidence, pieces, causal)
    spikes = _found("spiky", spiky(likeliest, evidence), pieces, tuning)
    found = [
        _found("resting", resting(likeliest, evidence), pieces, tuning),
        _found("jumping", jumping(evidence), pieces, tuning),
        _found("noisy", noisy(likeliest), pieces, tuning),
        spikes,
        *(Switched("bursting", one.switching, one.log_likelihood, np.nan, one.tuning) for one in bursts),
    ]
    if spikes_gated:  # then a bank that leaves them out has to be better than that
        gated = log_likelihood(_with_wild(tuning, spikes.switching), pieces)
        fixed, found = max(fixed, gated) + _DOUBT + _BETTER, [bank for bank in found if bank.switching.rejects]
    likelier = [bank for bank in found if _gain(bank) >= fixed]
    alone: Kind | None = None if spikes_gated else "spiky"  # beside it a filter that believes all is no rival
    best = _best(likelier, evidence, None if causal else tuning, alone)
    if best is not None and causal and wild is not None and len(wild.z) > len(evidence.z):
        best = _knowing_outliers(best, likeliest, evidence, wild)
    return None if best is None else replace(best, fixed_log_likelihood=fixed)


def _knowing_outliers(found: Switched, tuning: Tuning, evidence: Evidence, wild: Evidence) -> Switched:
    """Return a bank whose level jumps with the share of wild readings of all of them; others are as they were."""
    if found.kind not in ("jumping", "spiky"):
        return found
    share = 1 - len(evidence.z) / len(wild.z)
    bank = jumping(wild, share) if found.kind == "jumping" else spiky(tuning, wild)
    known, _ = searched(bank, pieces_of(wild, int(np.argmax(np.abs(wild.z[:, 0] - np.median(wild.z))))))
    return replace(found, switching=known) if _follows_motion(known, evidence, at_jumps=True) else found


def _with_wild(tuning: Tuning, like: InteractingModels) -> InteractingModels:
    """Return a fixed filter with the wild readings, and the jumps, of a bank: what a gate makes of it."""
    own, noise = tuning.component, tuning.noise_variance
    steady, abrupt = (replace(mode, noise_variance=noise) for mode in like.modes)
    walking = with_walking_level(own, like.wild_variance)
    return replace(like, modes=(replace(steady, component=own), replace(abrupt, component=walking)))


def _best(found: list[Switched], evidence: Evidence, smoothed: Tuning | None, alone: Kind | None) -> Switched | None:
    """Return the bank that foretells best and leaves no motion out, neither as wild readings nor as loud noise.

    A smoother has to err less than the fixed one as well, unless it is of the kind that stands `alone`, and first.
    """
    motion_is_wild, ranked = False, sorted(found, key=_gain, reverse=True)
    for bank in ranked:
        if bank.kind == "noisy" and motion_is_wild:
            continue
        if not _follows_motion(bank.switching, evidence):
            motion_is_wild = True
            continue
        first = bank is ranked[0] and bank.kind == alone
        if smoothed is None or first or errs_less(bank.switching, smoothed, evidence):
            return bank
    return None


def _follows_motion(switching: InteractingModels, evidence: Evidence, *, at_jumps: bool = False) -> bool:
    """Return whether a bank leaves out outliers only, if anything, and perhaps first readings after jumps."""
    if not switching.rejects:
        return True
    z = evidence.z[:, 0]
    return stand_out(z, find_wild(switching, z, evidence.elapsed), at_jumps=at_jumps)


def _gain(found: Switched) -> float:
    """Return by how much a bank foretells better; where loud noise might as well be motion, it is motion."""
    doubt = {"jumping": _DOUBT, "noisy": -_MOTION_FIRST}
    return found.log_likelihood + doubt.get(found.kind, -_BETTER)


def _found(kind: Kind, bank: ImmFamily, pieces: list[EvidencePiece], tuning: Tuning) -> Switched:
    switching, value = searched(bank, pieces)
    return Switched(kind, switching, value, np.nan, tuning)


def find_surprise(z: Floats) -> int | None:
    """Return the row where neighbouring means, over some length, differ far more than they mostly do.

    Noise, motion of one character and tones have no such row; a jump, rest between motions, outliers and noise
    that changes do. It only spares a search, and says where to look: the likelihood decides.
    """
    total, width = np.concatenate([[0.0], np.cumsum(z - z.mean())]), 1
    most, row = _SURPRISING * 1.4826, None
    while 8 * width <= len(z):
        stride = max(width // 2, 1)
        ends, ahead = total[::stride], width // stride
        means = ends[ahead:] - ends[:-ahead]
        details = np.abs(means[ahead:] - means[:-ahead])
        largest, middle = int(np.argmax(details)), float(np.median(details))
        if details[largest] > most * middle:
            most = float(details[largest]) / middle if middle > 0 else np.inf
            row = (largest + ahead) * stride
        width *= 2
    return row


def _alone(tuning: Tuning) -> InteractingModels:
    """Return a fixed filter as a bank of one mode."""
    return InteractingModels((Mode("fixed", tuning.component, tuning.noise_variance, 1.0),))
