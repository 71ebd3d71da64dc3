"""Where the numbers of a stream's channel stand: what it is made of, and all that moves.

Everything that moves is in two rows a channel, of float64 and of whole numbers: copied, they are its snapshot.
"""

from __future__ import annotations

from typing import NamedTuple

from becalm.core.arrays import Codes, Floats, Integers
from becalm.core.compiling import woven
from becalm.core.kernel_faults import MEMORY as MEMORY_OF_SENSOR
from becalm.core.kernel_watch import KEPT_HOPS, MEMORY
from becalm.core.sized import Size, Sizes, size

(
    LOW, HIGH, IMPOSSIBLE, STUCK,  # limits of the sensor: rails, magnitude, equal readings in a row
    LARGEST, ENOUGH,  # magnitude that a filter of its noise believes; what has to settle
    LONGEST, SPANS, TELLING,  # reach: steps, times the span of what was read, readings that tell the state
    GATED, THRESHOLD, AGREE, AT_MOST, LEVEL_STATE,  # the gate, as of `kernel_gate.Rule`
    DRIFT_AT, DEAD_BELOW,  # alarms: of a cumulative sum in parts of a sigma, of a window in parts^2
    TIMED, TIME_STD, TIME_INCLUDED, VARIANCE,  # uncertain time: s, unit^2 that R holds already, R
    FACTOR, CALIBRATED, RELATIVE, OFFSET,  # what widens sigma
    UNKNOWN_FROM,  # sigma from which on a row without a reading is a hole
    OUTLIERS,  # and the five after it, as of `kernel_outliers.Outliers`
) = range(26)  # fmt: skip
FIXED = OUTLIERS + 6

SENSOR = 0  # and those after it, see `kernel_faults`
NOW, LAST, LEVEL, TOLD, SLOPE, READ, POWER = range(MEMORY_OF_SENSOR, MEMORY_OF_SENSOR + 7)
"""Steps from the first reading since a start to the last row, and to the last reading; what readings are told from; the
last signal and its slope; the last reading that entered; sum of squares of the open hop of innovations."""
GATE = POWER + 1  # and the six after it, see `kernel_gate`
POWERS = GATE + 7  # and those of the last hops, in a ring
FILTER = POWERS + KEPT_HOPS
"""From there on the filter's state and its watch, as `kernel_settling.transfer` lays them out."""

KNOWN, READINGS, HOPS, SILENT, TOTALS, SQUARES_OF = 0, 1, 2, 3, 4, 7
"""How far the state is known; readings since the start; whole hops so far; whether the last window was silent; sums of
the last three hops, and sums of their squares."""
WATCH = 10  # and those after it, see `kernel_watch`
MISSED = WATCH + MEMORY  # whether the last row had no reading
COUNTS = MISSED + 1
VERDICTS = 16
MARKS = COUNTS + VERDICTS

UNKNOWN, GATHERING, DETERMINED = range(3)
"""Nothing was read; the readings do not tell the state yet, and are gathered as information; the filter runs."""

SENSED, FILTERED, FINISHED = range(3)
"""How far a block has come in each of the three passes over it."""

ONE: Size = size(1)


class Channels(NamedTuple):
    """What the channels of one size are made of."""

    F: Floats  # (C u, n, n) the steps of u lengths, channel after channel
    Q: Floats  # (C u, n, n)
    H: Floats  # (C, 1, n)
    C: Floats  # (C, 1, n) what of the state is signal
    R: Floats  # (C, 1, 1)
    fixed: Floats  # (C, FIXED)
    columns: Integers  # (C,) of the block


class Moving(NamedTuple):
    """All that moves."""

    numbers: Floats  # (C, FILTER + ...)
    marks: Integers  # (C, MARKS)


class Rows(NamedTuple):
    """A block of all channels, and when it came."""

    z: Floats  # (B, m)
    elapsed: Floats  # (B,) steps since the row before
    step: Integers  # (B,) which length that is
    lengths: Floats  # (u,)
    step_s: float

    @property
    def is_even(self) -> bool:
        """Whether each row comes a step after the one before."""
        return len(self.lengths) == 1 and bool(self.lengths[0] == 1.0)


class Work(NamedTuple):
    """What passes hand on to each other, a row a channel."""

    usable: Floats  # (C, B) readings, NaN where none may enter the filter
    normalised: Floats  # (C, B) innovations over their standard deviations, NaN where there is none
    anew: Codes  # (C, B) 1 where a reading comes after a gap beyond reach
    begun: Integers  # (C, 3) rows that each pass has done


class Heard(NamedTuple):
    """What the passes before made of one channel."""

    usable: Floats  # (B,) readings, NaN where none may enter the filter
    normalised: Floats  # (B,) innovations over their standard deviations, NaN where there is none


class Out(NamedTuple):
    """What is told."""

    signal: Floats  # (B, m)
    sigma: Floats  # (B, m)
    verdicts: Codes  # (B, m) comes with what is wrong with each row's time


@woven
def sizes_of_one(states: Size) -> Sizes:
    """Return the sizes of a model of one channel."""
    return Sizes(states, ONE)
