"""One row of the recursion: full, of one channel, or with the gain that has settled."""

from __future__ import annotations

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part
from becalm.core.kernel_one import new_reach, reach_back, take_one
from becalm.core.kernel_settling import LAST_STEP, SETTLED, Watch, notice
from becalm.core.kernel_steps import State, correct, joseph, look, predict, settled_step, weigh
from becalm.core.sized import Sizes
from becalm.core.system import Step


@compiled_part
def advance(  # noqa: PLR0913  (a part of the loops, which keep these apart for the compiler)
    sizes: Sizes, step: Step, number: float, z: Floats, row: int, state: State, watch: Watch, enough: float
) -> None:
    """Take one row of readings (N, m) after a step; its number, or length, tells steps apart; -1 stands for none.

    A gain is used again once `enough` has settled.
    """
    count = look(sizes, z, row, state)
    complete = count == len(sizes.channels)
    if complete and watch.counters[SETTLED] >= enough and number == watch.counters[LAST_STEP]:
        settled_step(sizes, step.F, step.H, z, row, state)
        return
    if complete and number >= 0 and len(sizes.channels) == 1:
        reach = new_reach(sizes)
        reach_back(sizes, step, reach)
        take_one(sizes, step, reach, z[row, 0], state)
        notice(sizes, step, number, state, watch, 1.0)
        return
    if number >= 0:
        predict(sizes, step.F, step.Q, state)
    weigh(sizes, step.H, step.R, state)
    correct(sizes, step.H, z, row, state)
    if count:
        joseph(sizes, step.H, step.R, state)
    notice(sizes, step, number, state, watch, 1.0 if complete else 0.0)
