"""Identify the modes of a channel: choose an IMM where it predicts the readings better than a fixed filter.

Five families of IMMs are tried; the few parameters of each are searched by likelihood (`banks`). A parameter leaves its
default only where the record clearly shows it, so that an IMM from a record with few changes of mode follows other
changes, too. An IMM smoother must also err less than the fixed smoother, clearly at hidden readings or by its estimated
risk: the best predictor need not be the best smoother. Source of the risk of nonlinear filters: Ramani, Blu and Unser,
IEEE TIP-17 (2008) 1540.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.imm.modes import InteractingModels, Mode
from becalm.core.model.components import ORDERS, with_walking_level
from becalm.identification.choose import choose
from becalm.identification.damping import damped
from becalm.identification.imputation import imputed
from becalm.identification.likelihood import Evidence, Tuning, tune_motion
from becalm.identification.modes.banks import (
    EvidencePiece,
    ImmFamily,
    Kind,
    errs_less,
    find_outliers,
    jumping,
    log_likelihood,
    noisy,
    of_first_mode,
    pieces_of,
    resting,
    search_imm,
    spiky,
    stand_out,
)
from becalm.identification.modes.bursts import find_bursting

_FEWEST = 256  # least number of readings; fewer cannot distinguish modes from noise
_SURPRISING = 6.0  # standard deviations: a larger difference of means is not due to Gaussian noise or uniform motion
_BETTER = 6.0  # gain in log-likelihood over a fixed filter that an IMM needs
_DOUBT = 15.0  # loss in log-likelihood that is accepted for jumping levels: about that of one change of mode
_MOTION_FIRST = 45.0  # gain in log-likelihood that loud noise needs: more than a shock of 100 readings makes


@dataclass(frozen=True)
class IdentifiedImm:
    """An identified IMM, and how well it predicts.

    Attributes
    ----------
    kind : {"resting", "jumping", "noisy", "spiky", "bursting"}
        See `becalm.identification.modes.banks`.
    switching : InteractingModels
        The modes, in steps.
    log_likelihood : float
        Log-likelihood of the readings that IMMs were compared on.
    fixed_log_likelihood : float
        Log-likelihood of the best fixed filter on the same readings, or, if a gate rejects spikes, the log-likelihood
        that an IMM had to reach; NaN where no filter was compared.
    tuning : Tuning
        The fixed filter that belongs to the IMM, perhaps with tones.
    """

    kind: Kind
    switching: InteractingModels
    log_likelihood: float
    fixed_log_likelihood: float
    tuning: Tuning


def find_switching(
    tuning: Tuning, evidence: Evidence, causal: bool, spikes_gated: bool = False, wild: Evidence | None = None
) -> IdentifiedImm | None:
    """Find the IMM that predicts a record best; None if a fixed filter is as good, or there are too few readings.

    Parameters
    ----------
    tuning : Tuning
        The fixed filter that was chosen, perhaps with tones.
    evidence : Evidence
        All the readings it was tuned on.
    causal : bool
        True for a filter, False for a smoother.
    spikes_gated : bool
        True if the fixed filter has an innovation gate; an IMM must then be better than the gated filter.
    wild : Evidence, optional
        The readings including gross outliers, which `evidence` does not contain. From them a causal IMM learns how
        rarely a distant reading is a jump. They are not used for a smoother.
    """
    surprise = find_surprise(evidence.z[:, 0]) if len(evidence.z) >= _FEWEST else None
    if surprise is None:
        return None
    pieces, motions = pieces_of(evidence, surprise), [tune_motion(order, evidence) for order in ORDERS]
    likeliest = damped(max(motions, key=lambda motion: motion.log_likelihood), evidence)
    fixed = max(log_likelihood(_one_mode(one), pieces) for one in (tuning, likeliest))
    bursts = find_bursting(likeliest, evidence, pieces, causal)
    spikes = _fit("spiky", spiky(likeliest, evidence), pieces, tuning)
    candidates = [
        _fit("resting", resting(likeliest, evidence), pieces, tuning),
        _fit("jumping", jumping(evidence), pieces, tuning),
        _fit("noisy", noisy(likeliest), pieces, tuning),
        spikes,
        *(IdentifiedImm("bursting", one.switching, one.log_likelihood, np.nan, one.tuning) for one in bursts),
    ]
    if spikes_gated:  # then an IMM must reject outliers, and be better than the gated filter
        gated = log_likelihood(_with_outliers(tuning, spikes.switching), pieces)
        fixed, candidates = (
            max(fixed, gated) + _DOUBT + _BETTER,
            [bank for bank in candidates if bank.switching.rejects],
        )
    likelier = [bank for bank in candidates if _gain(bank) >= fixed]
    alone: Kind | None = None if spikes_gated else "spiky"  # a filter without a gate is no rival of spiky
    best = _choose_imm(likelier, evidence, None if causal else tuning, alone)
    if best is not None and causal and wild is not None and len(wild.z) > len(evidence.z):
        best = _with_outlier_share(best, likeliest, evidence, wild)
    return None if best is None else replace(best, fixed_log_likelihood=fixed)


def _with_outlier_share(best: IdentifiedImm, tuning: Tuning, evidence: Evidence, wild: Evidence) -> IdentifiedImm:
    """Return an IMM tuned on all readings, with their share of outliers, if it is jumping or spiky; else unchanged."""
    if best.kind not in ("jumping", "spiky"):
        return best
    share = 1 - len(evidence.z) / len(wild.z)
    bank = jumping(wild, share) if best.kind == "jumping" else spiky(tuning, wild)
    tuned, _ = search_imm(bank, pieces_of(wild, int(np.argmax(np.abs(wild.z[:, 0] - np.median(wild.z))))))
    return replace(best, switching=tuned) if _follows_motion(tuned, evidence, at_jumps=True) else best


def _with_outliers(tuning: Tuning, like: InteractingModels) -> InteractingModels:
    """Return the IMM that represents a gated fixed filter: its motion with the outliers and jumps of `like`."""
    own, noise = tuning.component, tuning.noise_variance
    steady, abrupt = (replace(mode, noise_variance=noise) for mode in like.modes)
    walking = with_walking_level(own, like.wild_variance)
    return replace(like, modes=(replace(steady, component=own), replace(abrupt, component=walking)))


def _choose_imm(
    candidates: list[IdentifiedImm], evidence: Evidence, smoothed: Tuning | None, alone: Kind | None
) -> IdentifiedImm | None:
    """Return the IMM that predicts best and takes no motion for outliers or loud noise; None if there is none.

    An IMM smoother must also err less than the fixed one, unless the IMM ranks first and its kind is `alone`.
    """
    motion_is_wild, ranked = False, sorted(candidates, key=_gain, reverse=True)
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
    """Return whether the readings that an IMM rejects are outliers or, with `at_jumps`, first readings after jumps."""
    if not switching.rejects:
        return True
    z = evidence.z[:, 0]
    return stand_out(z, find_outliers(switching, z, evidence.elapsed), at_jumps=at_jumps)


def _gain(candidate: IdentifiedImm) -> float:
    """Return the log-likelihood of an IMM less the gain that its kind needs; loud noise needs the most."""
    doubt = {"jumping": _DOUBT, "noisy": -_MOTION_FIRST}
    return candidate.log_likelihood + doubt.get(candidate.kind, -_BETTER)


def _fit(kind: Kind, bank: ImmFamily, pieces: list[EvidencePiece], tuning: Tuning) -> IdentifiedImm:
    switching, value = search_imm(bank, pieces)
    return IdentifiedImm(kind, switching, value, np.nan, tuning)


def find_surprise(z: Floats) -> int | None:
    """Return the row at which the means of two adjacent blocks differ far more than usual; None if there is none.

    Blocks of several lengths are compared. Noise, uniform motion and tones have no such row; jumps, rests between
    motions, outliers and changing noise have one. Without such a row no IMM is searched; with one, the likelihood
    decides.
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


def _one_mode(tuning: Tuning) -> InteractingModels:
    """Return a fixed filter as an IMM of one mode."""
    return InteractingModels((Mode("fixed", tuning.component, tuning.noise_variance, 1.0),))


# Identify a robust filter, for records with up to one outlier in ten samples.
#
# Outliers inflate the noise, and hide motion and tones. So each outlier that the IMM finds is replaced by a draw from
# its distribution given all other readings, and the channel's filter and its IMM are chosen again.


def choose_robust(tuning: Tuning, evidence: Evidence, causal: bool) -> IdentifiedImm:
    """Choose the filter of one channel with many outliers.

    Parameters
    ----------
    tuning : Tuning
        The filter that was chosen as if there were no outliers.
    evidence : Evidence
        The readings with their outliers.
    causal : bool
        True for a filter, False for a smoother.
    """
    first, readings, elapsed = robust_filter(tuning, evidence), evidence.z[:, 0], evidence.elapsed
    outliers = find_outliers(first.switching, readings, elapsed)
    repaired = imputed(of_first_mode(tuning, first.switching), readings, elapsed, outliers)
    chosen = choose(repaired, elapsed, causal).tuning
    return first if chosen is None else robust_filter(chosen, evidence)


def robust_filter(tuning: Tuning, evidence: Evidence) -> IdentifiedImm:
    """Return the spiky IMM of a filter; its noise, process noise and outliers are identified by likelihood.

    Parameters
    ----------
    tuning : Tuning
        The filter to start from, perhaps with tones.
    evidence : Evidence
        The readings with their outliers.
    """
    switching, value = search_imm(spiky(tuning, evidence), pieces_of(evidence, len(evidence.z) // 2))
    return IdentifiedImm("spiky", switching, value, np.nan, tuning)
