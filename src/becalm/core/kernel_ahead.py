"""Blocks of rows with a settled gain: x[k] = A x[k-1] + G u[k] for many k at once.

One state at a time would wait for the one before. Looking ahead, x[k+4] = A^4 x[k] + A^3 G u[k+1] +
... + G u[k+4], four of them are independent and the machine computes them side by side; every index
is the loop's variable plus a constant, and each state has an array of its own, so that the compiler
sees it. Larger systems have enough to do within a row. Source of the idea: Parhi and Messerschmitt,
IEEE TASSP-37 (1989) 1099.
"""

from __future__ import annotations

from typing import NamedTuple

from becalm.core.arrays import BLOCK, Floats
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_matrices import multiply, transpose
from becalm.core.sized import Size, size, stack_matrix, stack_vector

AFTER = BLOCK + 1
"""Rows of states: the one before the block, and those of the block."""

AHEAD = 4
FOUR: Size = size(AHEAD)
_FEW_STATES, _FEW_INPUTS = 4, 3  # looking ahead costs n + 4 m products a state instead of n + m

Rows = tuple[Floats, ...]


class Loop(NamedTuple):
    """A recursion x[k + 1] = A x[k] + G u[k], prepared."""

    A: Floats  # (n, n)
    G: Floats  # (n, m)
    A4: Floats  # (n, n) fourth power of A
    W: Floats  # (n, 4 m) A^3 G, A^2 G, A G, G of each input


@woven
def new_loop(states: Size, inputs: Size) -> Loop:
    """Make room for a loop on the stack."""
    return Loop(
        stack_matrix(states, states),
        stack_matrix(states, inputs),
        stack_matrix(states, states),
        stack_matrix(states, inputs + inputs + inputs + inputs),
    )


@compiled_part
def prepare(states: Size, inputs: Size, loop: Loop) -> None:
    """Fill in what follows from A and G."""
    if not looks_ahead(states, inputs):
        return
    A2 = stack_matrix(states, states)
    multiply(states, states, loop.A, loop.A, A2)
    multiply(states, states, A2, A2, loop.A4)
    for c in range(len(inputs)):
        for i in range(len(states)):
            loop.W[i, AHEAD * c + 3] = loop.G[i, c]
        for lag in range(2, -1, -1):
            for i in range(len(states)):
                s = 0.0
                for j in range(len(states)):
                    s += loop.A[i, j] * loop.W[j, AHEAD * c + lag + 1]
                loop.W[i, AHEAD * c + lag] = s


@compiled_part
def looks_ahead(states: Size, inputs: Size) -> bool:
    """Whether a row is too little work for the machine, so that looking ahead pays."""
    return len(states) <= _FEW_STATES and len(inputs) <= _FEW_INPUTS


@compiled_part
def run_block(states: Size, inputs: Size, loop: Loop, u: Rows, x: Rows) -> None:
    """Run x[:, k + 1] = A x[:, k] + G u[:, k] over a block; x[:, 0] is there."""
    ahead = looks_ahead(states, inputs)
    _one_by_one(states, inputs, loop, u, x, 1, AHEAD - 1 if ahead else BLOCK)
    if not ahead:
        return
    for k in range(BLOCK - AHEAD + 1):
        for i in range(len(states)):
            s = 0.0
            for c in range(len(inputs)):
                for lag in range(len(FOUR)):
                    s += loop.W[i, AHEAD * c + lag] * u[c][k + lag]
            for j in range(len(states)):
                s += loop.A4[i, j] * x[j][k]
            x[i][k + 4] = s


@compiled_part
def run_back(states: Size, inputs: Size, loop: Loop, u: Rows, x: Rows) -> None:
    """Run x[:, k] = A x[:, k + 1] + G u[:, k] over a block, from its end on; x[:, BLOCK] is there."""
    ahead = looks_ahead(states, inputs)
    _one_by_one(states, inputs, loop, u, x, -1, AHEAD - 1 if ahead else BLOCK)
    if not ahead:
        return
    for k in range(BLOCK - AHEAD, -1, -1):
        for i in range(len(states)):
            s = 0.0
            for c in range(len(inputs)):
                for lag in range(len(FOUR)):
                    s += loop.W[i, AHEAD * c + 3 - lag] * u[c][k + lag]
            for j in range(len(states)):
                s += loop.A4[i, j] * x[j][k + 4]
            x[i][k] = s


@compiled_part
def _one_by_one(  # noqa: PLR0913
    states: Size, inputs: Size, loop: Loop, u: Rows, x: Rows, way: int, count: int
) -> None:
    """Run some rows onwards (`way` is 1) from the first of x, or backwards (-1) from the last."""
    n, at, enters_at = len(states), 0 if way > 0 else BLOCK, 0 if way > 0 else BLOCK - 1
    now, then = stack_vector(states), stack_vector(states)
    columns, enters = stack_matrix(states, states), stack_matrix(inputs, states)
    transpose(states, states, loop.A, columns)  # so that a column lies in one piece
    transpose(states, inputs, loop.G, enters)
    for i in range(n):
        now[i] = x[i][at]
    for k in range(count):
        for i in range(n):
            then[i] = 0.0
        for c in range(len(inputs)):
            for i in range(n):
                then[i] += enters[c, i] * u[c][enters_at + way * k]
        for j in range(n):
            for i in range(n):
                then[i] += columns[j, i] * now[j]
        for i in range(n):
            now[i] = then[i]
            x[i][at + way * (k + 1)] = then[i]


@compiled_part
def copy(x: Floats, first: int, row: Floats) -> None:
    """row[k] = x[first + k] over a block."""
    for k in range(BLOCK):
        row[k] = x[first + k]


@compiled_part
def fill(row: Floats, value: float) -> None:
    """Write one value to a block."""
    for k in range(BLOCK):
        row[k] = value


@compiled_part
def combine(inner: Size, weights: Floats, x: Rows, first: int, row: Floats) -> None:
    """row[k] = sum of weights[i] * x[i][first + k] over a block."""
    for k in range(BLOCK):
        s = 0.0
        for i in range(len(inner)):
            s += weights[i] * x[i][first + k]
        row[k] = s


@compiled_part
def add_up(terms: Floats) -> float:
    """Add a block pairwise, as exact as it is quick; the terms are used up."""
    half = BLOCK
    while half > 8:
        half //= 2
        for k in range(half):
            terms[k] += terms[k + half]
    total = 0.0
    for k in range(8):
        total += terms[k]
    return total
