"""Identify a robust filter, for records with up to one outlier in ten samples.

Outliers inflate the noise, and hide motion and tones. So once the IMM has found the outliers, each is replaced by a
draw from its distribution given all other readings, and the channel's filter and its IMM are chosen again.
"""

from __future__ import annotations

import numpy as np

from becalm.identification.choose import choose
from becalm.identification.imputation import imputed
from becalm.identification.likelihood import Evidence, Tuning
from becalm.identification.modes.banks import find_wild, of_first_mode, pieces_of, searched, spiky
from becalm.identification.modes.switching import Switched


def choose_robust(tuning: Tuning, evidence: Evidence, causal: bool) -> Switched:
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
    outliers = find_wild(first.switching, readings, elapsed)
    repaired = imputed(of_first_mode(tuning, first.switching), readings, elapsed, outliers)
    chosen = choose(repaired, elapsed, causal).tuning
    return first if chosen is None else robust_filter(chosen, evidence)


def robust_filter(tuning: Tuning, evidence: Evidence) -> Switched:
    """Return a fixed filter with heavy-tailed noise.

    Its noise, process noise and outliers are identified by likelihood.

    Parameters
    ----------
    tuning : Tuning
        The filter to start from, perhaps with tones.
    evidence : Evidence
        The readings with their outliers.
    """
    switching, value = searched(spiky(tuning, evidence), pieces_of(evidence, len(evidence.z) // 2))
    return Switched("spiky", switching, value, np.nan, tuning)
