"""Calm motion and violent motion: a filter for each, and the calm one tuned on what is calm.

One shock in a long record is enough to make a fixed filter so quick that it leaves most of the noise everywhere. So
the rows of violent motion are found by a first bank; the filter is chosen again as though they were missing; and a
bank of it, and of the same motion much louder, is searched. That is expectation and maximisation with hard decisions.
Source: Celeux and Govaert, Computational Statistics and Data Analysis 14 (1992) 315.
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
from becalm.identification.modes.bank_risk import hidden_errors
from becalm.identification.modes.banks import (
    EvidencePiece,
    ImmFamily,
    bursting,
    log_likelihood,
    of_first_mode,
    searched,
    with_wild_share,
)

_ROUNDS = 2  # of finding what is violent, and of tuning what is calm
_MOST = 0.3  # share of violent readings, from which on the calm is no exception to tune on
_BESIDE = 10  # readings on each side that count to it as well: its ends are not told from calm motion
_LIKELY = 0.5  # probability of a burst, from which a reading counts to it
_MOST_STATES = HIGHEST_ORDER + 1  # of a filter for which a bank is looked for: more keep a person waiting


class Bursting(NamedTuple):
    """A filter for calm motion, and the bank of it and of violent motion."""

    tuning: Tuning
    switching: InteractingModels
    log_likelihood: float


def find_bursting(
    tuning: Tuning, evidence: Evidence, pieces: list[EvidencePiece], causal: bool
) -> tuple[Bursting, Bursting]:
    """Find a bank of calm and violent motion, and the filter of calm motion; and the same without wild readings.

    Parameters
    ----------
    tuning : Tuning
        The fixed filter that foretells all readings best.
    evidence : Evidence
        The readings.
    pieces : list of EvidencePiece
        Those of them that banks are compared on; the last is about a row where something happened.
    causal : bool
        Whether it shall filter (True) or smooth.
    """
    found = _find_bursting(tuning, evidence, pieces, causal)
    believing = with_wild_share(found.switching, 0.0)
    return found, Bursting(found.tuning, believing, log_likelihood(believing, pieces))


def _find_bursting(tuning: Tuning, evidence: Evidence, pieces: list[EvidencePiece], causal: bool) -> Bursting:
    found, before = _searched(tuning, bursting(tuning, evidence), pieces[-1:]), np.zeros(len(evidence.z), dtype=bool)
    for _ in range(_ROUNDS):
        violent = _find_violent(found.switching, evidence)
        if np.array_equal(violent, before) or violent.mean() > _MOST:
            break
        calm, before = _without(violent, evidence), violent
        likeliest = [damped(tune_motion(order, calm), calm) for order in ORDERS]
        tried = [
            _searched(one, bursting(one, evidence, found.switching), pieces[-1:]) for one in likeliest if one.ratio > 0
        ]
        found = max([found, *tried], key=lambda one: one.log_likelihood)
    if not before.any():
        found = _searched(tuning, bursting(tuning, evidence), pieces)
        return found._replace(tuning=of_first_mode(tuning, found.switching))
    found = _searched(found.tuning, bursting(found.tuning, evidence, found.switching), pieces)
    chosen = _chosen(_without(before, evidence), causal)
    if chosen is None:
        return found
    other = _searched(chosen, bursting(chosen, evidence, found.switching), pieces)
    if causal:
        return max(found, other, key=lambda one: one.log_likelihood)
    errors = [hidden_errors(ImmFlow(one.switching, causal=False), evidence) for one in (found, other)]
    return other if errors[1].sum() <= errors[0].sum() else found  # what foretells best need not smooth best


def _chosen(calm: Evidence, causal: bool) -> Tuning | None:
    """Choose the filter of calm motion; without its tones, if a bank of them would have too many states."""
    choice = choose(calm.z[:, 0], calm.elapsed, causal)
    alone = None if choice.motion is None else damped(choice.motion, calm)
    fitting = (one for one in (choice.tuning, alone) if one is not None and one.ratio > 0)
    return next((one for one in fitting if len(one.component.drift) <= _MOST_STATES), None)


def _without(violent: Booleans, evidence: Evidence) -> Evidence:
    return Evidence.of(np.where(violent, np.nan, evidence.z[:, 0]), evidence.elapsed)


def _searched(tuning: Tuning, bank: ImmFamily, pieces: list[EvidencePiece]) -> Bursting:
    return Bursting(tuning, *searched(bank, pieces))


def _find_violent(switching: InteractingModels, evidence: Evidence) -> Booleans:
    """Tell which readings (N,) belong to violent motion, as a smoother sees it."""
    flow = ImmFlow(switching, causal=False, tells_modes=True)
    told = [*flow.push(evidence.z[:, 0], evidence.elapsed), *flow.finish()]
    violent = np.concatenate([one.parts[-1] for one in told]) > _LIKELY
    near: Booleans = np.convolve(violent, np.ones(2 * _BESIDE + 1), "same") > 0.5
    return near
