"""A robust filter: for records of which up to one reading in ten is wild.

Wild readings inflate the noise, and hide what moves and what hums; so once the bank has told which they are, each is
replaced by a draw from what all others say of it, the channel's filter is chosen again, and the bank with it.
Source of the draws: Rubin, Multiple Imputation for Nonresponse in Surveys (1987), chapter 1.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.switching import Switching
from becalm.noise.bank_risk import find_wild
from becalm.noise.banks import STANDS_OUT, middle_variance, pieces_of, searched, spiky
from becalm.noise.choose import choose
from becalm.noise.far import WINDOW
from becalm.noise.gating import imputed
from becalm.noise.likelihood import Evidence, Tuning
from becalm.noise.switching import Switched

_LIKELY = 0.5  # probability from which a reading is taken for a wild one
_PIECE = 1 << 15  # rows


class RobustChoice(NamedTuple):
    """What was found for one channel."""

    tuning: Tuning
    """The fixed filter, perhaps with tones, as the tame readings tell it."""

    switched: Switched
    """The same with wild readings, and with a level that may jump."""


def choose_robust(tuning: Tuning, readings: Floats, elapsed: Floats, causal: bool) -> RobustChoice:
    """Choose the filter of one channel of whose readings many are wild.

    Parameters
    ----------
    tuning : Tuning
        The filter chosen as if every reading were good.
    readings : (N,) float array
        In the channel's unit, NaN where missing.
    elapsed : (N,) float array
        Steps since the row before.
    causal : bool
        Whether the filter shall run causally.
    """
    readings = _well_begun(readings)
    evidence = Evidence.of(readings, elapsed)
    first = robust_filter(tuning, evidence)
    wild = find_wild(first.switching, readings, elapsed)
    tame = imputed(_steady(tuning, first.switching), readings, elapsed, wild)
    found = choose(tame, elapsed, causal).tuning
    return RobustChoice(tuning, first) if found is None else RobustChoice(found, robust_filter(found, evidence))


def robust_filter(tuning: Tuning, evidence: Evidence) -> Switched:
    """Return a fixed filter with heavy tails: its noise, its process noise and its wild readings found by likelihood.

    Parameters
    ----------
    tuning : Tuning
        The filter, perhaps with tones.
    evidence : Evidence
        The readings, wild ones among them.
    """
    pieces = [piece._replace(z=_well_begun(piece.z)) for piece in pieces_of(evidence, len(evidence.z) // 2)]
    switching, value = searched(spiky(tuning, evidence), pieces)
    return Switched("spiky", switching, value, np.nan)


def _well_begun(readings: Floats) -> Floats:
    """Return readings (N,) of which the first, which no filter can doubt, is the median of five where it stands out."""
    seen = np.flatnonzero(np.isfinite(readings))
    if len(seen) < WINDOW:
        return readings
    first, middle = seen[0], float(np.median(readings[seen[:WINDOW]]))
    if not abs(readings[first] - middle) > STANDS_OUT * np.sqrt(middle_variance(readings[seen])):
        return readings
    tame = readings.copy()
    tame[first] = middle
    return tame


def _steady(tuning: Tuning, switching: Switching) -> Tuning:
    """Return a tuning with the noise, and the process noise, of a bank that was made of it."""
    steady = switching.modes[0]
    ratio = float(steady.component.noise_density[0, 0]) / steady.noise_variance
    return replace(tuning, ratio=ratio, noise_variance=steady.noise_variance)
