"""Identify a robust filter, for records with up to one outlier in ten samples.

Wild readings inflate the noise, and hide what moves and what hums; so once the bank has told which they are, each is
replaced by a draw from what all others say of it, the channel's filter is chosen again, and the bank with it.
"""

from __future__ import annotations

import numpy as np

from becalm.identification.choose import choose
from becalm.identification.imputation import imputed
from becalm.identification.likelihood import Evidence, Tuning
from becalm.identification.modes.bank_risk import find_wild
from becalm.identification.modes.banks import of_first_mode, pieces_of, searched, spiky
from becalm.identification.modes.switching import Switched


def choose_robust(tuning: Tuning, evidence: Evidence, causal: bool) -> Switched:
    """Choose the filter of one channel of whose readings many are wild.

    Parameters
    ----------
    tuning : Tuning
        The filter chosen as if every reading were good.
    evidence : Evidence
        The readings, wild ones among them.
    causal : bool
        Whether the filter shall run causally.
    """
    first, readings, elapsed = robust_filter(tuning, evidence), evidence.z[:, 0], evidence.elapsed
    wild = find_wild(first.switching, readings, elapsed)
    tame = imputed(of_first_mode(tuning, first.switching), readings, elapsed, wild)
    found = choose(tame, elapsed, causal).tuning
    return first if found is None else robust_filter(found, evidence)


def robust_filter(tuning: Tuning, evidence: Evidence) -> Switched:
    """Return a fixed filter with heavy tails: its noise, its process noise and its wild readings found by likelihood.

    Parameters
    ----------
    tuning : Tuning
        The filter, perhaps with tones.
    evidence : Evidence
        The readings, wild ones among them.
    """
    switching, value = searched(spiky(tuning, evidence), pieces_of(evidence, len(evidence.z) // 2))
    return Switched("spiky", switching, value, np.nan, tuning)
