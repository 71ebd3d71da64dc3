"""Verdicts: what the filter did with each reading, with advice for the user."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Codes, Floats

BEYOND_ANY_SENSOR = 1e100
"""A magnitude whose square would overflow float64; no sensor measures it."""

AGREE, AT_MOST = 4, 4
"""Number of consecutive rejected readings after which the gate accepts them: if they agree with each other (AGREE), and
in any case (AT_MOST). A spike lasts one to three readings; longer deviations are motion: shocks, reversals, impacts.

They are defined here and not in `core/filter/gate.py`, so that a recipe can import them without loading a kernel."""


class Verdict(IntEnum):
    """What the filter did with one reading."""

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
"""For each verdict, True if the filter did not use the reading."""

NOT_READ = LOST & (np.arange(len(Verdict)) != Verdict.SPIKE)
"""For each verdict, True if the reading holds no information on the signal; a spike may have been motion."""

ADVICE = {
    Verdict.MISSING: "Missing readings are predicted across; sigma grows there.",
    Verdict.NONFINITE: "Infinite readings were treated as missing; look at the sensor or at its conversion.",
    Verdict.OVERRANGE: "Readings larger than any sensor gives were treated as missing; look at the file.",
    Verdict.SPIKE: "Spikes were left out as missing; look for loose contacts and switching loads, and if they are"
    " motion take [channel.gate] out of the recipe, or set wild_share = 0 in its modes.",
    Verdict.STEP: "The signal jumped, and the filter followed at once; check whether the sensor was moved or zeroed.",
    Verdict.CLIPPED: "Clipped readings show only that the signal reached the limit; widen the range or lower the gain.",
    Verdict.STUCK: "A stuck channel repeats its last reading; look at the cable, the converter and the driver, and if"
    " the signal may rest that long raise stuck_readings in the recipe.",
    Verdict.DEAD: "A dead channel has lost its noise, and with it its signal; look at the sensor's supply and cable.",
    Verdict.DRIFT: "Readings drift to one side of the signal; compare the sensor at rest, or with a slow reference.",
    Verdict.LATE: "Late rows are off their even time, but none was lost; stamp rows where they are measured.",
    Verdict.REPEATED: "Repeated rows have the time of the row before; look for a block that was written twice.",
    Verdict.OUTLIER: "Gross outliers were treated as missing; look for loose contacts and broken transfers, and if they"
    " are motion take outlier_distance and causal_outlier_distance out of the recipe.",
    Verdict.GAP: "Rows were lost before a gap, and sigma grows across it; look at the link and at the logger's buffer.",
    Verdict.HOLE: "In a long hole the model knows only the range of the signal, so no estimate is returned; to get its"
    " prediction, with a sigma as wide as that range, use --fill.",
    Verdict.RUNAWAY: "Estimates far outside the range of all readings were left out: a fault of the filter or of its"
    " recipe; tune again, and if it happens again report it, with the recipe.",
}


class Judged(NamedTuple):
    """Checked readings, and the number of readings with each verdict."""

    readings: Floats  # (N,) NaN where not used
    counts: dict[Verdict, int]
    verdicts: Codes  # (N,) verdict of each reading


def judge(z: Floats, largest: float = BEYOND_ANY_SENSOR) -> Judged:
    """Replace infinite or too large readings of one channel (N,) by NaN; return the input itself if there are none."""
    counts = dict.fromkeys(Verdict, 0)
    if not len(z) or -largest <= z.min() <= z.max() <= largest:  # False if any reading is NaN
        counts[Verdict.USED] = len(z)
        return Judged(z, counts, np.zeros(len(z), np.int8))
    if -largest <= np.fmin.reduce(z) <= np.fmax.reduce(z) <= largest:  # all others are within range
        verdicts = np.isnan(z).astype(np.int8)  # 1 is Verdict.MISSING
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
    counts = np.bincount(verdicts, minlength=len(Verdict))
    return {verdict: int(counts[verdict]) for verdict in Verdict}
