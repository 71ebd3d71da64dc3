"""Verdicts: what the filter did with each reading, and what the user can do about it."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Codes, Floats

BEYOND_ANY_SENSOR = 1e100
"""Largest magnitude of a reading: no sensor measures more, and squares of larger ones may overflow float64."""

AGREE, AT_MOST = 4, 4
"""After this many rejected readings in a row the gate accepts them: after `AGREE` if they agree with each other, after
`AT_MOST` in any case. A spike lasts one to three readings; longer deviations are motion: shocks, reversals, impacts.

These numbers are defined here and not in `core/filter/gate.py`, so that a recipe can import them without the kernel."""


class Verdict(IntEnum):
    """What the filter did with the reading of a row, or a fault of the reading, of its time or of its estimate."""

    USED = 0
    MISSING = 1
    NONFINITE = 2  # infinite
    OVERRANGE = 3  # too large to be a reading
    SPIKE = 4  # rejected by the innovation gate, or by the modes of an IMM
    STEP = 5  # used, because the signal jumped
    CLIPPED = 6  # at a saturation limit or beyond
    STUCK = 7  # in a run of too many equal readings
    DEAD = 8  # used, but the innovations have lost their noise
    DRIFT = 9  # used, but the innovations are shifted to one side
    LATE = 10  # used, but the time of the row is not on the even grid
    REPEATED = 11  # used, but the row has the same time as the row before
    GAP = 12  # used; rows were lost before it
    OUTLIER = 13  # far from its neighbours, or a value that marks missing readings
    HOLE = 14  # no estimate, because sigma is too large without readings
    RUNAWAY = 15  # no estimate, because the filter's result was far outside the range of all readings


LOST = np.isin(
    list(Verdict),
    [
        Verdict.MISSING, Verdict.NONFINITE, Verdict.OVERRANGE, Verdict.SPIKE, Verdict.CLIPPED, Verdict.STUCK,
        Verdict.OUTLIER,
    ],
)  # fmt: skip
"""For each verdict, True if it means that the filter did not use the reading. `HOLE` and `RUNAWAY` are verdicts on the
estimate of a row; they do not show whether its reading was used."""

NOT_READ = LOST & (np.arange(len(Verdict)) != Verdict.SPIKE)
"""For each verdict, True if it means that the row has no valid reading: `LOST` without `SPIKE`, because a spike may be
motion."""

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
    """Replace infinite or too large readings of one channel (N,) by NaN; if there are none, `readings` is z itself."""
    counts = dict.fromkeys(Verdict, 0)
    if not len(z) or -largest <= z.min() <= z.max() <= largest:  # False if any reading is NaN
        counts[Verdict.USED] = len(z)
        return Judged(z, counts, np.zeros(len(z), np.int8))
    if -largest <= np.fmin.reduce(z) <= np.fmax.reduce(z) <= largest:  # all readings except NaN are within range
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
