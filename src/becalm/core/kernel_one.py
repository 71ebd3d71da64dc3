"""A row of one channel in as short a chain of operations as can be, for rows that no block takes.

Each row waits for the covariance of the row before, so what counts is not how much is computed but how
long the longest chain is. S needs no predicted covariance: with g = H F it is g P g' + H Q H' + R.
"""

from __future__ import annotations

from typing import NamedTuple

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_steps import LARGEST, State, joseph, move, see_through
from becalm.core.sized import Sizes, stack_matrix, stack_vector
from becalm.core.system import Step


class Reach(NamedTuple):
    """What a reading says of the state one step before."""

    HF: Floats  # (1, n)
    QH: Floats  # (n,) Q H'
    c: Floats  # (1,) H Q H' + R


@woven
def new_reach(sizes: Sizes) -> Reach:
    """Make room for a reach on the stack."""
    return Reach(stack_matrix(sizes.channels, sizes.states), stack_vector(sizes.states), stack_vector(sizes.channels))


@compiled_part
def reach_back(sizes: Sizes, step: Step, reach: Reach) -> None:
    """Fill in what follows from a step."""
    see_through(sizes, step.H, step.F, reach.HF)
    reach.c[0] = step.R[0, 0]
    for i in range(len(sizes.states)):
        reach.QH[i] = 0.0
        for j in range(len(sizes.states)):
            reach.QH[i] += step.Q[i, j] * step.H[0, j]
        reach.c[0] += step.H[0, i] * reach.QH[i]


@compiled_part
def take_one(sizes: Sizes, step: Step, reach: Reach, reading: float, state: State) -> None:
    """Equations (1) to (7) of a reading that arrived."""
    n, F, P = len(sizes.states), step.F, state.P
    Fx, t, PH = stack_vector(sizes.states), stack_vector(sizes.states), stack_vector(sizes.states)
    S, nu = reach.c[0], reading
    for i in range(n):
        Fx[i], t[i] = 0.0, 0.0
        for j in range(n):
            Fx[i] += F[i, j] * state.x[j]
            t[i] += P[i, j] * reach.HF[0, j]
        Fx[i] = min(max(Fx[i], -LARGEST), LARGEST)
        nu -= step.H[0, i] * Fx[i]
        S += reach.HF[0, i] * t[i]
    for i in range(n):
        PH[i] = reach.QH[i]
        for j in range(n):
            PH[i] += F[i, j] * t[j]
    move(sizes, F, step.Q, P)
    state.D[0], state.nu[0] = S, nu
    for i in range(n):
        state.K[i, 0] = PH[i] / S if S > 0.0 else 0.0
        state.x[i] = Fx[i] + state.K[i, 0] * nu
    if 2.0 * step.R[0, 0] >= S:
        subtract(sizes, PH, state)
    else:
        joseph(sizes, step.H, step.R, state)


@compiled_part
def subtract(sizes: Sizes, PH: Floats, state: State) -> None:
    """Equation (7) as P - K (P H')': no variance loses more than half where S <= 2 R, so no more than one bit."""
    for i in range(len(sizes.states)):
        for j in range(i + 1):
            s = state.P[i, j] - state.K[i, 0] * PH[j]
            state.P[i, j] = s
            state.P[j, i] = s
