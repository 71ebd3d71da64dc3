"""What later readings say of a bank that switches, brought back over a step.

To each mode they are a likelihood of its state, exp(g + r' (h - c) - (h - c)' Y (h - c) / 2), about a centre c.
Over a step it stays one, whatever Q is: Y >= 0, and all that is inverted is I and something positive, so that
neither a state without noise, nor one that sleeps, nor one that no reading sees does any harm. Source: the
two-filter form of Fraser and Potter, IEEE TAC-14 (1969) 387.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_matrices import factor, multiply
from becalm.core.kernel_settling import transfer_matrix, transfer_vector
from becalm.core.kernel_switching_row import BankSizes
from becalm.core.sized import Size, size, stack_matrix, stack_vector

_ONE: Size = size(1)
_MUCH = 1e100


class Outlook(NamedTuple):
    """What the readings from a row on say of it, to each mode."""

    c: Floats  # (M, n)
    r: Floats  # (M, n)
    Y: Floats  # (M, n n)
    g: Floats  # (M,)
    known: Floats  # (1,) 0 where there are none


class Return(NamedTuple):
    """The way back over a step, of one mode; on the stack."""

    G: Floats  # (n, n) Q = G G'
    YG: Floats  # (n, n)
    L: Floats  # (n, n) factors of I + G' Y G
    D: Floats  # (n,)
    Y: Floats  # (n, n) what is said of the state before the step


@woven
def new_outlook(sizes: BankSizes) -> Outlook:
    """Make room for an outlook on the stack."""
    n, modes, squared, _ = sizes
    return Outlook(
        stack_matrix(modes, n), stack_matrix(modes, n), stack_matrix(modes, squared), stack_vector(modes),
        stack_vector(_ONE),
    )  # fmt: skip


@woven
def new_return(sizes: BankSizes) -> Return:
    """Make room for a way back on the stack."""
    n = sizes.states
    return Return(stack_matrix(n, n), stack_matrix(n, n), stack_matrix(n, n), stack_vector(n), stack_matrix(n, n))


def outlook_length(states: int, modes: int) -> int:
    """Return how many numbers hold an outlook."""
    return modes * (1 + 2 * states + states * states) + 1


@compiled_part
def transfer_outlook(sizes: BankSizes, ahead: Outlook, memory: Floats, saving: float) -> None:
    """Save an outlook in memory, or load it."""
    n, modes, squared, _ = sizes
    at = transfer_vector(_ONE, ahead.known, memory, 0, saving)
    at = transfer_matrix(modes, n, ahead.c, memory, at, saving)
    at = transfer_matrix(modes, n, ahead.r, memory, at, saving)
    at = transfer_matrix(modes, squared, ahead.Y, memory, at, saving)
    transfer_vector(modes, ahead.g, memory, at, saving)


@compiled_part
def unpack(states: Size, packed: Floats, j: int, A: Floats) -> None:
    """Write row j of several matrices, (M, n n), as a matrix."""
    n = len(states)
    for a in range(n):
        for b in range(n):
            A[a, b] = packed[j, a * n + b]


@compiled_part
def pack(states: Size, A: Floats, packed: Floats, j: int) -> None:
    """Write a matrix as row j of several, (M, n n)."""
    n = len(states)
    for a in range(n):
        for b in range(n):
            packed[j, a * n + b] = A[a, b]


@compiled_part
def root(states: Size, P: Floats, G: Floats) -> None:
    """Write G with P = G G', lower triangular; a direction without variance has a column of zeros."""
    n, L, D = len(states), stack_matrix(states, states), stack_vector(states)
    factor(states, P, L, D)
    for a in range(n):
        for b in range(n):
            G[a, b] = 0.0
        for b in range(a):
            G[a, b] = L[a, b] * np.sqrt(D[b])
        G[a, a] = np.sqrt(D[a])


@compiled_part
def factor_beside_one(states: Size, G: Floats, YG: Floats, L: Floats, D: Floats) -> tuple[float, float]:
    """Factor I + G' (Y G) = L D L'; no pivot is below 1, but by rounding.

    Returns its determinant as a logarithm, 0 unless it is huge, and the number that is left.
    """
    n, B = len(states), stack_matrix(states, states)
    for a in range(n):
        for b in range(a + 1):
            s = 1.0 if a == b else 0.0
            for k in range(n):
                s += G[k, a] * YG[k, b]
            B[a, b] = s
    product, logarithm = 1.0, 0.0
    for a in range(n):
        d = B[a, a]
        for c in range(a):
            d -= L[a, c] * L[a, c] * D[c]
        D[a] = max(d, 1.0)
        for b in range(a + 1, n):
            s = B[b, a]
            for c in range(a):
                s -= L[b, c] * L[a, c] * D[c]
            L[b, a] = s / D[a]
        if D[a] > _MUCH:
            logarithm += np.log(D[a])
        else:
            product *= D[a]
        if product > _MUCH:
            logarithm += np.log(product)
            product = 1.0
    return logarithm, product


@compiled_part
def solve_lower(states: Size, L: Floats, v: Floats) -> None:
    """Replace v (n,) by L^-1 v."""
    for a in range(len(states)):
        for c in range(a):
            v[a] -= L[a, c] * v[c]


@compiled_part
def solve_upper(states: Size, L: Floats, v: Floats) -> None:
    """Replace v (n,) by L'^-1 v."""
    n = len(states)
    for a in range(n - 1, -1, -1):
        for c in range(a + 1, n):
            v[a] -= L[c, a] * v[c]


@compiled_part
def shrink_outlook(sizes: BankSizes, F: Floats, Q: Floats, i: int, ahead: Outlook, way: Return) -> float:  # noqa: PLR0913
    """Equation (10): Y = F' (A' Y A + W' W) F over the step of mode i, W = (I + G' Y G)^-1 G' Y, A = I - G W.

    Returns the logarithm of the determinant of I + G' Y G.
    """
    n, states = len(sizes.states), sizes.states
    Y, W = stack_matrix(states, states), stack_matrix(states, states)
    A, YA = stack_matrix(states, states), stack_matrix(states, states)
    column = stack_vector(states)
    unpack(states, ahead.Y, i, Y)
    root(states, Q, way.G)
    multiply(states, states, Y, way.G, way.YG)
    logarithm, product = factor_beside_one(states, way.G, way.YG, way.L, way.D)
    for b in range(n):
        for a in range(n):
            column[a] = way.YG[b, a]
        solve_lower(states, way.L, column)
        for a in range(n):
            column[a] /= way.D[a]
        solve_upper(states, way.L, column)
        for a in range(n):
            W[a, b] = column[a]
            s = 1.0 if a == b else 0.0
            for k in range(n):
                s -= way.G[a, k] * column[k]
            A[a, b] = s
    multiply(states, states, A, F, YA)
    multiply(states, states, W, F, A)
    multiply(states, states, Y, YA, W)
    for a in range(n):
        for b in range(a + 1):
            s = 0.0
            for k in range(n):
                s += YA[k, a] * W[k, b] + A[k, a] * A[k, b]
            way.Y[a, b] = s
            way.Y[b, a] = s
    determinant: float = logarithm + np.log(product)
    return determinant


@compiled_part
def turn_outlook(  # noqa: PLR0913
    sizes: BankSizes, F: Floats, i: int, ahead: Outlook, way: Return, x: Floats, r: Floats
) -> float:
    """Equation (11): write r of the state before the step of mode i, about the mean x (n,); return its g.

    The determinant is left out.
    """
    n, states = len(sizes.states), sizes.states
    q, u, y = stack_vector(states), stack_vector(states), stack_vector(states)
    g = slope_at(sizes, F, i, ahead, x, q)
    for a in range(n):
        s = 0.0
        for k in range(n):
            s += way.G[k, a] * q[k]
        u[a] = s
    solve_lower(states, way.L, u)
    for a in range(n):
        y[a] = u[a] / way.D[a]
        g += 0.5 * u[a] * y[a]
    solve_upper(states, way.L, y)
    for a in range(n):
        for k in range(n):
            q[a] -= way.YG[a, k] * y[k]
    for a in range(n):
        s = 0.0
        for k in range(n):
            s += F[k, a] * q[k]
        r[a] = s
    return g


@compiled_part
def slope_at(sizes: BankSizes, F: Floats, i: int, ahead: Outlook, x: Floats, q: Floats) -> float:  # noqa: PLR0913
    """Write the slope q of what is said to mode i at F x; return its logarithm there."""
    n, d = len(sizes.states), stack_vector(sizes.states)
    g: float = ahead.g[i]
    for a in range(n):
        s = -ahead.c[i, a]
        for k in range(n):
            s += F[a, k] * x[k]
        d[a] = s
    for a in range(n):
        s = 0.0
        for k in range(n):
            s += ahead.Y[i, a * n + k] * d[k]
        q[a] = ahead.r[i, a] - s
        g += (ahead.r[i, a] - 0.5 * s) * d[a]
    return g
