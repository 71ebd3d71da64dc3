"""What became of each reading: every outcome is a value, with advice."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Codes, Floats

BEYOND_ANY_SENSOR = 1e100
"""A magnitude whose square would leave float64; no sensor reads it."""

AGREE, AT_MOST = 4, 4
"""Rejects in a row that are believed after all: where they agree with each other, and whatever they are. A spike stands
alone, or two or three do; what lasts longer is motion: a shock, a reversal, an impact.

They are defined here and not in `core/filter/gate.py`, so that a recipe can name them without loading a kernel."""


class Verdict(IntEnum):
    """What became of one reading."""

    USED = 0
    MISSING = 1
    NONFINITE = 2
    OVERRANGE = 3
    SPIKE = 4
    STEP = 5
    CLIPPED = 6
    STUCK = 7
    DEAD = 8
    DRIFT = 9
    LATE = 10
    REPEATED = 11
    GAP = 12
    OUTLIER = 13
    HOLE = 14
    RUNAWAY = 15


LOST = np.isin(
    list(Verdict),
    [
        Verdict.MISSING, Verdict.NONFINITE, Verdict.OVERRANGE, Verdict.SPIKE, Verdict.CLIPPED, Verdict.STUCK,
        Verdict.OUTLIER,
    ],
)  # fmt: skip
"""For each verdict, whether the reading did not enter the filter."""

NOT_READ = LOST & (np.arange(len(Verdict)) != Verdict.SPIKE)
"""For each verdict, whether there was no reading to tell of the signal; a spike may have been motion."""

ADVICE = {
    Verdict.MISSING: "Missing readings are predicted across; sigma grows there.",
    Verdict.NONFINITE: "Infinite readings were treated as missing; look at the sensor or at its conversion.",
    Verdict.OVERRANGE: "Readings that no sensor gives were treated as missing; look at the file.",
    Verdict.SPIKE: "Spikes were left out as missing; look for loose contacts and switching loads, and if they are"
    " motion take [channel.gate] out of the recipe, or set wild_share = 0 in its modes.",
    Verdict.STEP: "The signal jumped, and the filter followed at once; look whether the sensor was moved or zeroed.",
    Verdict.CLIPPED: "Clipped readings only say that the signal was at least there; widen the range or lower the gain.",
    Verdict.STUCK: "A stuck channel repeats its last reading; look at the cable, the converter and the driver, and if"
    " it may rest so long raise stuck_readings in the recipe.",
    Verdict.DEAD: "A dead channel has lost its noise, and with it its signal; look at the sensor's supply and cable.",
    Verdict.DRIFT: "Readings drift to one side of the signal; compare the sensor at rest, or with a slow reference.",
    Verdict.LATE: "Late rows came off their even time, none was lost; stamp them where they are measured.",
    Verdict.REPEATED: "Repeated rows have the time of the row before; look for a block that was written twice.",
    Verdict.OUTLIER: "Gross outliers were treated as missing; look for loose contacts and broken transfers, and if they"
    " are motion take outlier_distance and causal_outlier_distance out of the recipe.",
    Verdict.GAP: "Rows were lost before a gap, and sigma grows across it; look at the link and at the logger's buffer.",
    Verdict.HOLE: "In a long hole the model knows no more than how far the signal goes, and nothing is told; for its"
    " guess, with a sigma as wide as that, take --fill.",
    Verdict.RUNAWAY: "Estimates left everything that was read, and are not told: a fault of the filter or of its"
    " recipe; tune anew, and if they come again report it, with the recipe.",
}


class Judged(NamedTuple):
    """Readings that may enter a filter, and how many met each verdict."""

    readings: Floats  # (N,) NaN where not used
    counts: dict[Verdict, int]
    verdicts: Codes  # (N,) what became of each


def judge(z: Floats, largest: float = BEYOND_ANY_SENSOR) -> Judged:
    """Let only finite, possible readings of one channel (N,) through; where all are, they come back as they are."""
    counts = dict.fromkeys(Verdict, 0)
    if not len(z) or -largest <= z.min() <= z.max() <= largest:  # NaN makes both NaN
        counts[Verdict.USED] = len(z)
        return Judged(z, counts, np.zeros(len(z), np.int8))
    if -largest <= np.fmin.reduce(z) <= np.fmax.reduce(z) <= largest:  # nothing but NaN is wrong
        verdicts = np.isnan(z).astype(np.int8)  # which is MISSING
        return Judged(z, counts | counted(verdicts), verdicts)
    verdicts = np.select(
        [np.isnan(z), np.isinf(z), np.abs(z) > largest],
        [Verdict.MISSING, Verdict.NONFINITE, Verdict.OVERRANGE],
        Verdict.USED,
    ).astype(np.int8)
    counts |= counted(verdicts)
    return Judged(np.where(verdicts == Verdict.USED, z, np.nan), counts, verdicts)


def counted(verdicts: Codes) -> dict[Verdict, int]:
    """Count the verdicts (N,) of each kind."""
    if not verdicts.any():
        return dict.fromkeys(Verdict, 0) | {Verdict.USED: len(verdicts)}
    found = np.bincount(verdicts, minlength=len(Verdict))
    return {verdict: int(found[verdict]) for verdict in Verdict}
