"""The gate of a stream: one reading held against what the filter itself expects of it, before it is taken."""

from __future__ import annotations

import math

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part
from becalm.core.kernel_gate import AGREEING, REJECTED, SINCE, SPIKE, STEP, USED, WANDERED, Rule, jump, reject, wander
from becalm.core.kernel_matrices import copy_matrix
from becalm.core.kernel_one import Reach, reach_back
from becalm.core.kernel_steps import State, Step, move
from becalm.core.sized import Sizes


@compiled_part
def foretell(sizes: Sizes, reach: Reach, state: State) -> tuple[float, float]:
    """Return what a reading is expected to be, and the variance of its innovation."""
    y, S = 0.0, reach.c[0]
    for i in range(len(sizes.states)):
        y += reach.HF[0, i] * state.x[i]
        for j in range(len(sizes.states)):
            S += reach.HF[0, i] * state.P[i, j] * reach.HF[0, j]
    return y, S


@compiled_part
def gate_reading(  # noqa: PLR0913
    sizes: Sizes, step: Step, reach: Reach, rule: Rule, reading: float, state: State, ahead: State, variances: Floats,
    counters: Floats,
) -> int:  # fmt: skip
    """Judge a reading, NaN where none came: the twin of `kernel_gate.find_outliers`.

    At a STEP `variances` gets what the states gain before it. `ahead` is room for the predicted covariance.
    """
    if counters[AGREEING] > 0.0:
        counters[WANDERED] += wander(sizes, step, state.P)
    if math.isnan(reading):
        return USED
    reach_back(sizes, step, reach)
    y, S = foretell(sizes, reach, state)
    nu = reading - y
    if counters[SINCE] < 0.0 or not abs(nu) > rule.threshold * math.sqrt(S):
        counters[REJECTED] = counters[AGREEING] = 0.0
        counters[SINCE] += 1.0
        return USED
    if not reject(rule, step.R[0, 0], nu, counters):
        return SPIKE
    copy_matrix(sizes.states, sizes.states, state.P, ahead.P)
    move(sizes, step.F, step.Q, ahead.P)
    jump(sizes, step, nu, rule, ahead, variances, counters)
    counters[REJECTED] = counters[AGREEING] = 0.0
    counters[SINCE] += 1.0
    return STEP
