"""Identify an IMM with two modes, calm and violent motion, and tune the calm one on the calm rows.

A single shock in a long record makes a fixed filter so fast that it passes most of the noise everywhere. Therefore a
first IMM finds the rows of violent motion, and the filter is chosen again as if those rows were missing. Then an IMM is
searched that consists of this filter and the same motion with a much larger Q. The method is expectation maximisation
with hard decisions. Source: Celeux and Govaert, Computational Statistics and Data Analysis 14 (1992) 315.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans
from becalm.core.imm.flow import ImmFlow
from becalm.core.imm.modes import InteractingModels
from becalm.core.model.components import HIGHEST_ORDER, ORDERS
from becalm.identification.choose import choose
from becalm.identification.damping import damped
from becalm.identification.likelihood import Evidence, Tuning, tune_motion
from becalm.identification.modes.banks import (
    EvidencePiece,
    ImmFamily,
    bursting,
    hidden_errors,
    log_likelihood,
    of_first_mode,
    search_imm,
    with_wild_share,
)

_ROUNDS = 2  # most rounds of finding the violent rows and tuning on the calm rows
_MOST_VIOLENT = 0.3  # largest share of violent readings; with more, the calm rows are too few to tune on
_MARGIN = 10  # readings on each side of a burst that count as part of it, because its ends look like calm motion
_LIKELY = 0.5  # probability of the burst mode above which a reading belongs to a burst
_MOST_STATES = HIGHEST_ORDER + 1  # most states of a filter in an IMM; with more the search would be too slow


class CalmAndBurstImm(NamedTuple):
    """A filter for calm motion, the IMM of calm and violent motion, and the log-likelihood of the IMM."""

    tuning: Tuning
    switching: InteractingModels
    log_likelihood: float


def find_bursting(
    tuning: Tuning, evidence: Evidence, pieces: list[EvidencePiece], causal: bool
) -> tuple[CalmAndBurstImm, CalmAndBurstImm]:
    """Find the IMM of calm and violent motion and its calm filter, with rejection of outliers and, second, without.

    Parameters
    ----------
    tuning : Tuning
        The fixed filter that predicts all readings best.
    evidence : Evidence
        The readings.
    pieces : list of EvidencePiece
        The readings that IMMs are compared on; the last piece contains the row that `find_large_change` returns.
    causal : bool
        True for a filter, False for a smoother.
    """
    bursts = _find_bursting(tuning, evidence, pieces, causal)
    without_outliers = with_wild_share(bursts.switching, 0.0)
    return bursts, CalmAndBurstImm(bursts.tuning, without_outliers, log_likelihood(without_outliers, pieces))


def _find_bursting(tuning: Tuning, evidence: Evidence, pieces: list[EvidencePiece], causal: bool) -> CalmAndBurstImm:
    best, before = _search(tuning, bursting(tuning, evidence), pieces[-1:]), np.zeros(len(evidence.z), dtype=bool)
    for _ in range(_ROUNDS):
        violent = _find_violent(best.switching, evidence)
        if np.array_equal(violent, before) or violent.mean() > _MOST_VIOLENT:
            break
        calm, before = _without_rows(violent, evidence), violent
        likeliest = [damped(tune_motion(order, calm), calm) for order in ORDERS]
        tried = [
            _search(one, bursting(one, evidence, best.switching), pieces[-1:]) for one in likeliest if one.ratio > 0
        ]
        best = max([best, *tried], key=lambda one: one.log_likelihood)
    if not before.any():
        best = _search(tuning, bursting(tuning, evidence), pieces)
        return best._replace(tuning=of_first_mode(tuning, best.switching))
    best = _search(best.tuning, bursting(best.tuning, evidence, best.switching), pieces)
    chosen = _choose_calm(_without_rows(before, evidence), causal)
    if chosen is None:
        return best
    other = _search(chosen, bursting(chosen, evidence, best.switching), pieces)
    if causal:
        return max(best, other, key=lambda one: one.log_likelihood)
    errors = [hidden_errors(ImmFlow(one.switching, causal=False), evidence) for one in (best, other)]
    return other if errors[1].sum() <= errors[0].sum() else best  # the best predictor need not be the best smoother


def _choose_calm(calm: Evidence, causal: bool) -> Tuning | None:
    """Choose the filter of calm motion, without tones if an IMM with them would have too many states."""
    choice = choose(calm.z[:, 0], calm.elapsed, causal)
    toneless = None if choice.motion is None else damped(choice.motion, calm)
    fitting = (one for one in (choice.tuning, toneless) if one is not None and one.ratio > 0)
    return next((one for one in fitting if len(one.component.drift) <= _MOST_STATES), None)


def _without_rows(violent: Booleans, evidence: Evidence) -> Evidence:
    return Evidence.of(np.where(violent, np.nan, evidence.z[:, 0]), evidence.elapsed)


def _search(tuning: Tuning, family: ImmFamily, pieces: list[EvidencePiece]) -> CalmAndBurstImm:
    return CalmAndBurstImm(tuning, *search_imm(family, pieces))


def _find_violent(switching: InteractingModels, evidence: Evidence) -> Booleans:
    """Return which readings (N,) belong to violent motion, or are near it, by the IMM smoother."""
    flow = ImmFlow(switching, causal=False, with_probabilities=True)
    smoothed = [*flow.push(evidence.z[:, 0], evidence.elapsed), *flow.finish()]
    violent = np.concatenate([one.parts[-1] for one in smoothed]) > _LIKELY
    near: Booleans = np.convolve(violent, np.ones(2 * _MARGIN + 1), "same") > 0.5
    return near
