"""Identify the modes of a channel: choose an IMM where it predicts the readings better than a fixed filter.

Five families of IMMs are tried; the few parameters of each are searched by likelihood (`banks`). A parameter changes
from its default only if the record clearly requires it, so that an IMM identified from few changes of mode also follows
other changes. An IMM smoother must also err less than the fixed smoother, clearly at hidden readings or by its
estimated risk, because the best predictor need not be the best smoother. Source of the risk of nonlinear filters:
Ramani, Blu and Unser, IEEE TIP-17 (2008) 1540.
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
    rejects_stand_out,
    resting,
    search_imm,
    spiky,
)
from becalm.identification.modes.bursts import find_bursting

_FEWEST = 256  # least number of readings; fewer cannot distinguish modes from noise
_LARGE_CHANGE = 6.0  # difference of means, in standard deviations, that Gaussian noise and uniform motion do not have
_BETTER = 6.0  # least gain in log-likelihood of an IMM over a fixed filter
_DOUBT = 15.0  # largest loss in log-likelihood of jumping levels: about the loss by one change of mode
_MOTION_FIRST = 45.0  # least gain in log-likelihood of loud noise: more than the gain in a shock of 100 readings


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
        The readings with gross outliers, which `evidence` does not contain. They show how often a distant reading is an
        outlier and not a jump. Only a causal IMM uses them.
    """
    changed_row = find_large_change(evidence.z[:, 0]) if len(evidence.z) >= _FEWEST else None
    if changed_row is None:
        return None
    pieces, motions = pieces_of(evidence, changed_row), [tune_motion(order, evidence) for order in ORDERS]
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
            [one for one in candidates if one.switching.rejects],
        )
    likelier = [one for one in candidates if _gain(one) >= fixed]
    exempt: Kind | None = None if spikes_gated else "spiky"  # without a gate, a fixed smoother is no alternative
    best = _choose_imm(likelier, evidence, None if causal else tuning, exempt)
    if best is not None and causal and wild is not None and len(wild.z) > len(evidence.z):
        best = _with_outlier_share(best, likeliest, evidence, wild)
    return None if best is None else replace(best, fixed_log_likelihood=fixed)


def _with_outlier_share(best: IdentifiedImm, tuning: Tuning, evidence: Evidence, wild: Evidence) -> IdentifiedImm:
    """Return an IMM tuned on all readings, with their share of outliers, if it is jumping or spiky; else unchanged."""
    if best.kind not in ("jumping", "spiky"):
        return best
    share = 1 - len(evidence.z) / len(wild.z)
    family = jumping(wild, share) if best.kind == "jumping" else spiky(tuning, wild)
    tuned, _ = search_imm(family, pieces_of(wild, int(np.argmax(np.abs(wild.z[:, 0] - np.median(wild.z))))))
    return replace(best, switching=tuned) if _follows_motion(tuned, evidence, at_jumps=True) else best


def _with_outliers(tuning: Tuning, like: InteractingModels) -> InteractingModels:
    """Return the IMM that represents a gated fixed filter: its motion with the outliers and jumps of `like`."""
    own, noise = tuning.component, tuning.noise_variance
    steady, abrupt = (replace(mode, noise_variance=noise) for mode in like.modes)
    walking = with_walking_level(own, like.wild_variance)
    return replace(like, modes=(replace(steady, component=own), replace(abrupt, component=walking)))


def _choose_imm(
    candidates: list[IdentifiedImm], evidence: Evidence, smoothed: Tuning | None, exempt: Kind | None
) -> IdentifiedImm | None:
    """Return the IMM that predicts best and does not treat motion as outliers or loud noise; None if there is none.

    An IMM smoother must also err less than the fixed smoother, unless the IMM ranks first and its kind is `exempt`.
    """
    motion_is_wild, ranked = False, sorted(candidates, key=_gain, reverse=True)
    for candidate in ranked:
        if candidate.kind == "noisy" and motion_is_wild:
            continue
        if not _follows_motion(candidate.switching, evidence):
            motion_is_wild = True
            continue
        first = candidate is ranked[0] and candidate.kind == exempt
        if smoothed is None or first or errs_less(candidate.switching, smoothed, evidence):
            return candidate
    return None


def _follows_motion(switching: InteractingModels, evidence: Evidence, *, at_jumps: bool = False) -> bool:
    """Return whether the readings that an IMM rejects are outliers or, with `at_jumps`, first readings after jumps."""
    if not switching.rejects:
        return True
    z = evidence.z[:, 0]
    return rejects_stand_out(z, find_outliers(switching, z, evidence.elapsed), at_jumps=at_jumps)


def _gain(candidate: IdentifiedImm) -> float:
    """Return the log-likelihood of an IMM less the gain required of its kind, which is largest for loud noise."""
    doubt = {"jumping": _DOUBT, "noisy": -_MOTION_FIRST}
    return candidate.log_likelihood + doubt.get(candidate.kind, -_BETTER)


def _fit(kind: Kind, family: ImmFamily, pieces: list[EvidencePiece], tuning: Tuning) -> IdentifiedImm:
    switching, value = search_imm(family, pieces)
    return IdentifiedImm(kind, switching, value, np.nan, tuning)


def find_large_change(z: Floats) -> int | None:
    """Return the row at which the means of two adjacent blocks differ far more than usual; None if there is none.

    Blocks of several lengths are compared. Noise, uniform motion and tones have no such row; jumps, rests between
    motions, outliers and changing noise have one. An IMM is searched only in a record with such a row.
    """
    total, width = np.concatenate([[0.0], np.cumsum(z - z.mean())]), 1
    most, row = _LARGE_CHANGE * 1.4826, None
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
# Outliers inflate the identified noise, and hide motion and tones. Therefore each outlier that the IMM finds is
# replaced by a draw from its distribution given all other readings, and the channel's filter and its IMM are chosen
# again.


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
