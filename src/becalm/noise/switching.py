"""Modes found from a recording: a filter that switches, where it foretells the readings better than a fixed one.

Four banks are tried, each with few numbers, which are searched by likelihood (`banks`). A number leaves its
default only where the record clearly says so, so that a record that shows few switches still gets a bank that
follows any. A smoother has to err less by its estimated risk as well: what foretells best need not smooth best.
Source of that estimate for filters that are not linear: Ramani, Blu and Unser, IEEE TIP-17 (2008) 1540.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.components import ORDERS, with_walking_level
from becalm.core.switching import Mode, Switching
from becalm.noise.bank_risk import errs_less
from becalm.noise.banks import Bank, Kind, Piece, jumping, log_likelihood, noisy, pieces_of, resting, searched, spiky
from becalm.noise.far import NONE_FAR, Far
from becalm.noise.likelihood import Evidence, Tuning, tune_motion

_FEWEST = 256  # readings, below which no switch can be told from noise
_SURPRISING = 6.0  # standard deviations: a difference of means that Gaussian noise and motion do not make
_BETTER = 6.0  # of a log-likelihood, for which a filter that switches is taken
_DOUBT = 15.0  # of it, which levels that jump may seem to cost: about what one switch does


@dataclass(frozen=True)
class Switched:
    """A bank, and how well it foretells.

    Attributes
    ----------
    kind : {"resting", "jumping", "noisy", "spiky"}
        See `becalm.noise.banks`.
    switching : Switching
        The modes, in steps.
    log_likelihood : float
        Of the readings that banks were compared on.
    fixed_log_likelihood : float
        Of the best fixed filter, on the same readings.
    """

    kind: Kind
    switching: Switching
    log_likelihood: float
    fixed_log_likelihood: float


def find_switching(
    tuning: Tuning, evidence: Evidence, causal: bool, spikes_gated: bool = False, far: Far = NONE_FAR
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
    far : Far
        What is known of readings that the evidence is without.
    """
    surprise = find_surprise(evidence.z[:, 0]) if len(evidence.z) >= _FEWEST else None
    if surprise is None:
        return None
    pieces, motions = pieces_of(evidence, surprise), [tune_motion(order, evidence) for order in ORDERS]
    likeliest = max(motions, key=lambda motion: motion.log_likelihood)
    fixed = max(log_likelihood(_alone(one), pieces) for one in (tuning, likeliest))
    found = [
        _found("resting", resting(likeliest, evidence), pieces),
        _found("jumping", jumping(evidence, far), pieces),
        _found("noisy", noisy(likeliest), pieces),
        _found("spiky", spiky(likeliest, evidence), pieces),
    ]
    if spikes_gated:  # then a bank that leaves them out has to be better than that
        gated = log_likelihood(_with_wild(tuning, found[3].switching), pieces)
        fixed, found = max(fixed, gated) + _DOUBT + _BETTER, [found[1], found[3]]
    best = max(found, key=_gain)
    if _gain(best) < fixed:
        return None
    alone = best.kind == "spiky" and not spikes_gated  # beside it a filter that believes all is no rival
    enough = causal or alone or errs_less(best.switching, tuning, evidence)
    return replace(best, fixed_log_likelihood=fixed) if enough else None


def _with_wild(tuning: Tuning, like: Switching) -> Switching:
    """Return a fixed filter with the wild readings, and the jumps, of a bank: what a gate makes of it."""
    own, noise = tuning.component, tuning.noise_variance
    steady, abrupt = (replace(mode, noise_variance=noise) for mode in like.modes)
    walking = with_walking_level(own, like.wild_variance)
    return replace(like, modes=(replace(steady, component=own), replace(abrupt, component=walking)))


def _gain(found: Switched) -> float:
    return found.log_likelihood + (_DOUBT if found.kind == "jumping" else -_BETTER)


def _found(kind: Kind, bank: Bank, pieces: list[Piece]) -> Switched:
    switching, value = searched(bank, pieces)
    return Switched(kind, switching, value, np.nan)


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


def _alone(tuning: Tuning) -> Switching:
    """Return a fixed filter as a bank: two modes that are alike, so that no other kernel is compiled."""
    one = Mode("fixed", tuning.component, tuning.noise_variance, 1.0)
    return Switching((one, replace(one, name="the same")))
