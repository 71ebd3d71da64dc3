"""The door to streams: one call takes a block of all channels of one size through its three passes."""

from __future__ import annotations

from becalm.core.compiling import compiled
from becalm.core.kernel_stream_filter import new_desk, run_filter
from becalm.core.kernel_stream_layout import (
    FILTERED,
    FINISHED,
    SENSED,
    Channels,
    Heard,
    Moving,
    Out,
    Rows,
    Work,
    sizes_of_one,
)
from becalm.core.kernel_stream_sense import find_starts, sense
from becalm.core.kernel_stream_tell import tell
from becalm.core.sized import Size


@compiled
def run_streams(states: Size, channels: Channels, rows: Rows, moving: Moving, work: Work, out: Out) -> int:  # noqa: PLR0913  (a door for Python: what is read, what moves, what is written)
    """Take a block; return how many channels stopped at a row where their state is not known.

    `work.begun` tells how far each channel has come, and where it stopped. There Python starts it from the readings
    alone (`starting`), and comes again.
    """
    sizes, stopped = sizes_of_one(states), 0
    desk = new_desk(sizes)
    for c in range(len(channels.columns)):
        fixed, column, begun = channels.fixed[c], channels.columns[c], work.begun[c]
        numbers, marks = moving.numbers[c], moving.marks[c]
        if not begun[SENSED]:
            begun[SENSED] = 1
            sense(fixed, rows.z, rows.elapsed, column, numbers, out.verdicts, work.usable[c])
            find_starts(fixed, work.usable[c], rows.elapsed, numbers, marks, work.anew[c])
        begun[FILTERED] = run_filter(sizes, channels, c, rows, work, numbers, marks, out, begun[FILTERED], desk)
        heard = Heard(work.usable[c], work.normalised[c])
        tell(fixed, column, rows, heard, numbers, marks, out, begun[FINISHED], begun[FILTERED])
        begun[FINISHED] = begun[FILTERED]
        stopped += begun[FILTERED] < len(rows.elapsed)
    return stopped
