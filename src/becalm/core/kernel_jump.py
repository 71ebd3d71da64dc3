"""Covariances of one channel's moving gain, eight rows side by side: each from the one eight rows before.

Over d rows a predicted covariance moves by M -> A (M^-1 + L L')^-1 A' + Q, as it does over one row, with
other A, L, Q; and two such moves are again one. So one row gives two, two give four, and of eight rows
none waits for another. Source: the doubling algorithm of Anderson, Int. J. Control 28 (1978) 295.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import BLOCK, Floats
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_ahead import Rows, add_up
from becalm.core.kernel_matrices import copy_matrix, multiply
from becalm.core.sized import Size, size, stack_matrix, stack_vector
from becalm.core.system import Step

FAR = 8
"""Rows of the longest jump: enough to be computed side by side."""

_MOST_TOLD = 64.0  # by the readings of a jump, sum of |L L'| |M|: rounding grows by no more than as much
_ONE: Size = size(1)


class Jump(NamedTuple):
    """A move over some rows."""

    A: Floats  # (n, n)
    L: Floats  # (n, n) L L' is what their readings tell of the state
    Q: Floats  # (n, n)


class Jumps(NamedTuple):
    """Moves over one, two, four and eight rows."""

    one: Jump
    two: Jump
    four: Jump
    eight: Jump
    step: Floats  # (1,) the number of the step that they were made of


class Loss(NamedTuple):
    """What readings take away from a covariance M: W D W', where I + L' M L = T D T'."""

    W: Floats  # (n, n) M L (T D)'^-1
    T: Floats  # (n, n) lower triangle
    D: Floats  # (n,) one over its diagonal


@woven
def new_jump(states: Size) -> Jump:
    """Make room for a jump on the stack."""
    return Jump(stack_matrix(states, states), stack_matrix(states, states), stack_matrix(states, states))


@woven
def new_jumps(states: Size) -> Jumps:
    """Make room for jumps on the stack; they are of no step yet."""
    step = stack_vector(_ONE)
    step[0] = -1.0
    return Jumps(new_jump(states), new_jump(states), new_jump(states), new_jump(states), step)


@woven
def new_loss(states: Size) -> Loss:
    """Make room for a loss on the stack."""
    return Loss(stack_matrix(states, states), stack_matrix(states, states), stack_vector(states))


@compiled_part
def prepare_jumps(states: Size, step: Step, number: int, jumps: Jumps) -> None:
    """Make the jumps of a step whose sensor is noisy."""
    if jumps.step[0] == number:
        return
    jumps.step[0] = number
    one, C = jumps.one, stack_matrix(states, states)
    copy_matrix(states, states, step.F, one.A)
    copy_matrix(states, states, step.Q, one.Q)
    for i in range(len(states)):
        for j in range(len(states)):
            C[i, j] = step.H[0, i] * step.H[0, j] / step.R[0, 0]
    root(states, C, one.L)
    double(states, one, jumps.two)
    double(states, jumps.two, jumps.four)
    double(states, jumps.four, jumps.eight)


@compiled_part
def root(states: Size, C: Floats, L: Floats) -> None:
    """Factor C = L L', the pivot first of which most is left, and use C up; NaN where it is beyond any number."""
    n, known, whole = len(states), 0.0, stack_vector(states)
    for i in range(n):
        whole[i] = C[i, i] if C[i, i] > 0.0 else 1.0
        for j in range(n):
            known += 0.0 * C[i, j]
    for s in range(n):
        p = 0
        for i in range(1, n):
            p = i if C[i, i] * whole[p] > C[p, p] * whole[i] else p
        scale = 1.0 / np.sqrt(C[p, p]) if C[p, p] > 0.0 else 0.0
        for i in range(n):
            L[i, s] = scale * C[i, p] + known
        for i in range(n):
            for j in range(n):
                C[i, j] -= L[i, s] * L[j, s]


@compiled_part
def weigh_loss(states: Size, L: Floats, M: Floats, loss: Loss) -> None:
    """Find what readings that tell L L' take away from M."""
    n, W, T, D = len(states), loss.W, loss.T, loss.D
    for i in range(n):
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += M[i, k] * L[k, j]
            W[i, j] = s
    for j in range(n):
        for i in range(j, n):
            s = 1.0 if i == j else 0.0
            for k in range(n):
                s += L[k, i] * W[k, j]
            for k in range(j):
                s -= T[i, k] * T[j, k] * D[k]
            T[i, j] = s
        D[j] = 1.0 / T[j, j]
    divide_by(states, loss, W)


@compiled_part
def divide_by(states: Size, loss: Loss, W: Floats) -> None:
    """W becomes W (T D)'^-1."""
    for i in range(len(states)):
        for j in range(len(states)):
            for k in range(j):
                W[i, j] -= loss.T[j, k] * loss.D[k] * W[i, k]


@compiled_part
def leap(states: Size, jump: Jump, M: Floats) -> None:
    """Move a predicted covariance over the rows of a jump."""
    n, AM, loss = len(states), stack_matrix(states, states), new_loss(states)
    weigh_loss(states, jump.L, M, loss)
    for i in range(n):
        for j in range(i + 1):
            s = M[i, j]
            for k in range(n):
                s -= loss.W[i, k] * loss.W[j, k] * loss.D[k]
            M[i, j] = s
            M[j, i] = s
    multiply(states, states, jump.A, M, AM)
    for i in range(n):
        for j in range(i + 1):
            s = jump.Q[i, j]
            for k in range(n):
                s += AM[i, k] * jump.A[j, k]
            M[i, j] = s
            M[j, i] = s


@compiled_part
def double(states: Size, once: Jump, twice: Jump) -> None:
    """Make one jump of two: A (I + Q C)^-1 A, C + A' C (I + Q C)^-1 A and Q moved once, with C = L L'."""
    loss, V = new_loss(states), stack_matrix(states, states)
    weigh_loss(states, once.L, once.Q, loss)
    copy_matrix(states, states, once.L, V)
    copy_matrix(states, states, once.Q, twice.Q)
    divide_by(states, loss, V)
    join_transitions(states, once, loss, V, twice)
    join_information(states, once, loss, V, twice)
    leap(states, once, twice.Q)


@compiled_part
def join_transitions(states: Size, once: Jump, loss: Loss, V: Floats, twice: Jump) -> None:
    """Write A (I + Q C)^-1 A = A (I - W D V') A, where V = L (T D)'^-1."""
    kept, moved = stack_matrix(states, states), stack_matrix(states, states)
    for i in range(len(states)):
        for j in range(len(states)):
            s = 1.0 if i == j else 0.0
            for k in range(len(states)):
                s -= loss.W[i, k] * loss.D[k] * V[j, k]
            kept[i, j] = s
    multiply(states, states, once.A, kept, moved)
    multiply(states, states, moved, once.A, twice.A)


@compiled_part
def join_information(states: Size, once: Jump, loss: Loss, V: Floats, twice: Jump) -> None:
    """Write the root of C + A' C (I + Q C)^-1 A = L L' + A' V D V' A."""
    n, AV, C = len(states), stack_matrix(states, states), stack_matrix(states, states)
    for i in range(n):
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += once.A[k, i] * V[k, j]
            AV[i, j] = s
    for i in range(n):
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += once.L[i, k] * once.L[j, k] + AV[i, k] * loss.D[k] * AV[j, k]
            C[i, j] = s
    root(states, C, twice.L)


@compiled_part
def set_row(states: Size, P: Floats, M: Rows, k: int) -> None:
    """Write a covariance to row k of M, the rows of a lower triangle."""
    at = 0
    for i in range(len(states)):
        for j in range(i + 1):
            M[at][k] = P[i, j]
            at += 1


@compiled_part
def get_row(states: Size, M: Rows, k: int, P: Floats) -> None:
    """Read a covariance from row k of M, the rows of a lower triangle."""
    at = 0
    for i in range(len(states)):
        for j in range(i + 1):
            P[i, j] = M[at][k]
            P[j, i] = M[at][k]
            at += 1


@compiled_part
def leap_from(states: Size, jump: Jump, M: Rows, k: int, far: int) -> None:
    """Fill in row k + far of M from row k."""
    own = stack_matrix(states, states)
    get_row(states, M, k, own)
    leap(states, jump, own)
    set_row(states, own, M, k + far)


@compiled_part
def leap_through(states: Size, jumps: Jumps, M: Rows) -> None:
    """Fill in a block of covariances from the first of them."""
    for k in range(1):
        leap_from(states, jumps.one, M, k, 1)
    for k in range(2):
        leap_from(states, jumps.two, M, k, 2)
    for k in range(4):
        leap_from(states, jumps.four, M, k, 4)
    for k in range(BLOCK - FAR):
        leap_from(states, jumps.eight, M, k, FAR)


@compiled_part
def keeps_digits(states: Size, jumps: Jumps, M: Rows, terms: Floats) -> bool:
    """Whether no row of M loses so much over the longest jump that digits go with it; not where it is NaN."""
    n, L, C = len(states), jumps.eight.L, stack_matrix(states, states)
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for k in range(n):
                s += L[i, k] * L[j, k]
            C[i, j] = abs(s) if i == j else 2.0 * abs(s)
    for k in range(BLOCK):
        told, at = 0.0, 0
        for i in range(n):
            for j in range(i + 1):
                told += C[i, j] * abs(M[at][k])
                at += 1
        terms[k] = 0.0 if told <= _MOST_TOLD else 1.0
    return add_up(terms) == 0.0
