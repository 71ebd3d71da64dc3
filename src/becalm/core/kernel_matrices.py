"""Small matrices in Numba: products, copies, factors and inverses."""

from __future__ import annotations

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part
from becalm.core.sized import Size, stack_matrix

_DEAD_PIVOT = 1e-15


@compiled_part
def multiply(rows: Size, columns: Size, A: Floats, B: Floats, C: Floats) -> None:
    """C = A B, with A (rows, rows), B and C (rows, columns); C is another array than B."""
    for i in range(len(rows)):
        for j in range(len(columns)):
            s = 0.0
            for k in range(len(rows)):
                s += A[i, k] * B[k, j]
            C[i, j] = s


@compiled_part
def copy_matrix(rows: Size, columns: Size, A: Floats, B: Floats) -> None:
    """B = A, both (rows, columns)."""
    for i in range(len(rows)):
        for j in range(len(columns)):
            B[i, j] = A[i, j]


@compiled_part
def transpose(rows: Size, columns: Size, A: Floats, B: Floats) -> None:
    """B = A', with A (rows, columns)."""
    for i in range(len(rows)):
        for j in range(len(columns)):
            B[j, i] = A[i, j]


@compiled_part
def factor(channels: Size, S: Floats, L: Floats, D: Floats) -> None:
    """Factor S = L D L'; a pivot that rounding alone has left is dead."""
    m = len(channels)
    for a in range(m):
        d = S[a, a]
        for c in range(a):
            d -= L[a, c] * L[a, c] * D[c]
        D[a] = d if d > _DEAD_PIVOT * S[a, a] else 0.0
        for b in range(a + 1, m):
            s = S[b, a]
            for c in range(a):
                s -= L[b, c] * L[a, c] * D[c]
            L[b, a] = s / D[a] if D[a] > 0.0 else 0.0


@compiled_part
def solve(channels: Size, L: Floats, D: Floats, v: Floats) -> None:
    """Replace v (m,) by S^-1 v, from the factors L D L'."""
    m = len(channels)
    for a in range(m):
        for c in range(a):
            v[a] -= L[a, c] * v[c]
    for a in range(m):
        v[a] = v[a] / D[a] if D[a] > 0.0 else 0.0
    for a in range(m - 1, -1, -1):
        for c in range(a + 1, m):
            v[a] -= L[c, a] * v[c]


@compiled_part
def invert(states: Size, A: Floats, B: Floats) -> bool:
    """B = A^-1, by Gauss and Jordan with pivots from the column; False where there is none."""
    n, own = len(states), stack_matrix(states, states)
    copy_matrix(states, states, A, own)
    for i in range(n):
        for j in range(n):
            B[i, j] = 1.0 if i == j else 0.0
    for c in range(n):
        p = c
        for i in range(c + 1, n):
            p = i if abs(own[i, c]) > abs(own[p, c]) else p
        if not abs(own[p, c]) > 0.0:
            return False
        scale = 1.0 / own[p, c]
        for j in range(n):
            own[p, j], own[c, j] = own[c, j], own[p, j] * scale
            B[p, j], B[c, j] = B[c, j], B[p, j] * scale
        for i in range(n):
            weight = own[i, c] if i != c else 0.0
            for j in range(n):
                own[i, j] -= weight * own[c, j]
                B[i, j] -= weight * B[c, j]
    return True
