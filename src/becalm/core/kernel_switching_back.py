"""A bank that switches, smoothed: coming back, each mode is told what the later readings said.

For every pair of a mode before a step and a mode after it, the smoothed belief of the later row is carried
back as Rauch, Tung and Striebel do; the pair is as probable as its forward probability times how well the
later row's smoothed state fits what the earlier mode foretold. Without that factor a jump that only later
readings reveal would stay unseen. Source: Barber, J. Mach. Learn. Res. 7 (2006) 2515 (expectation correction).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, Integers
from becalm.core.compiling import compiled, compiled_part, woven
from becalm.core.kernel_matrices import factor, solve
from becalm.core.kernel_settling import LOAD, SAVE
from becalm.core.kernel_switching import (
    UNLIKELY,
    Bank,
    BankSizes,
    Beliefs,
    SwitchingTrace,
    new_beliefs,
    transfer_beliefs,
    write_modes,
)
from becalm.core.sized import layer, stack_matrix, stack_vector

_NEGLIGIBLE = 1e-12  # share of a mode that is not looked at
_LEAST = -1e300


class Pair(NamedTuple):
    """A mode before a step, seen from a mode after it; on the stack."""

    FP: Floats  # (n, n)
    L: Floats  # (n, n) factors of the predicted covariance
    D: Floats  # (n,)
    e: Floats  # (n,) P_predicted^-1 (x_later - x_predicted)
    J: Floats  # (n, n) gain
    A: Floats  # (n, n) I - J F


class Sums(NamedTuple):
    """What is gathered of one mode over all modes after it, on the stack."""

    x: Floats  # (M, n) the state of each pair
    P: Floats  # (M, n n)
    share: Floats  # (M, M) probability of each pair, [before, after]


@woven
def new_pair(sizes: BankSizes) -> Pair:
    """Make room for a pair on the stack."""
    n = sizes.states
    return Pair(
        stack_matrix(n, n), stack_matrix(n, n), stack_vector(n), stack_vector(n), stack_matrix(n, n), stack_matrix(n, n)
    )


@woven
def new_sums(sizes: BankSizes) -> Sums:
    """Make room for the sums on the stack."""
    n, modes, squared = sizes
    return Sums(stack_matrix(modes, n), stack_matrix(modes, squared), stack_matrix(modes, modes))


@compiled_part
def meet(  # noqa: PLR0913
    sizes: BankSizes, F: Floats, Q: Floats, j: int, i: int, now: Beliefs, later: Beliefs, pair: Pair
) -> float:
    """Predict mode j by mode i; return how well what is known later fits, as a log-likelihood but for a constant."""
    n, S = len(sizes.states), stack_matrix(sizes.states, sizes.states)
    for a in range(n):
        s = later.x[i, a]
        for k in range(n):
            s -= F[a, k] * now.x[j, k]
        pair.e[a] = s
        for b in range(n):
            s = 0.0
            for k in range(n):
                s += F[a, k] * now.P[j, k * n + b]
            pair.FP[a, b] = s
    for a in range(n):
        for b in range(a + 1):
            s = Q[a, b]
            for k in range(n):
                s += pair.FP[a, k] * F[b, k]
            S[a, b] = s
            S[b, a] = s
    factor(sizes.states, S, pair.L, pair.D)
    d = stack_vector(sizes.states)
    for a in range(n):
        d[a] = pair.e[a]
    solve(sizes.states, pair.L, pair.D, pair.e)
    fit = 0.0
    for a in range(n):
        fit -= 0.5 * d[a] * pair.e[a]
        fit -= 0.5 * np.log(pair.D[a]) if pair.D[a] > 0.0 else 0.0
    return fit


@compiled_part
def carry_back(  # noqa: PLR0913
    sizes: BankSizes, F: Floats, Q: Floats, j: int, i: int, now: Beliefs, later: Beliefs, pair: Pair, sums: Sums
) -> None:
    """Smooth mode j by what mode i believes later: P = A P A' + J (P_later + Q) J' with A = I - J F."""
    n, column = len(sizes.states), stack_vector(sizes.states)
    for b in range(n):
        for a in range(n):
            column[a] = pair.FP[a, b]
        solve(sizes.states, pair.L, pair.D, column)
        s = now.x[j, b]
        for a in range(n):
            pair.J[b, a] = column[a]
            s += pair.FP[a, b] * pair.e[a]
        sums.x[i, b] = s
    write_spread(sizes, F, Q, j, i, now, later, pair, sums)


@compiled_part
def write_spread(  # noqa: PLR0913
    sizes: BankSizes, F: Floats, Q: Floats, j: int, i: int, now: Beliefs, later: Beliefs, pair: Pair, sums: Sums
) -> None:
    """Write the covariance of a pair, given its gain."""
    n, J, A = len(sizes.states), pair.J, pair.A
    AP, JV = stack_matrix(sizes.states, sizes.states), stack_matrix(sizes.states, sizes.states)
    for a in range(n):
        for b in range(n):
            s = 1.0 if a == b else 0.0
            for k in range(n):
                s -= J[a, k] * F[k, b]
            A[a, b] = s
    for a in range(n):
        for b in range(n):
            s, t = 0.0, 0.0
            for k in range(n):
                s += A[a, k] * now.P[j, k * n + b]
                t += J[a, k] * (later.P[i, k * n + b] + Q[k, b])
            AP[a, b], JV[a, b] = s, t
    for a in range(n):
        for b in range(a + 1):
            s = 0.0
            for k in range(n):
                s += AP[a, k] * A[b, k] + JV[a, k] * J[b, k]
            sums.P[i, a * n + b] = s
            sums.P[i, b * n + a] = s


@compiled_part
def share_out(sizes: BankSizes, bank: Bank, s: int, now: Beliefs, later: Beliefs, pair: Pair, sums: Sums) -> None:  # noqa: PLR0913
    """Tell how probable each pair of modes is, given all readings."""
    n, modes = sizes.states, len(sizes.modes)
    T = layer(bank.T, s, sizes.modes, sizes.modes)
    for i in range(modes):
        best, total = _LEAST, 0.0
        for j in range(modes):
            sums.share[j, i] = _LEAST
            if later.mu[i] > _NEGLIGIBLE:
                F, Q = layer(bank.F, s * modes + i, n, n), layer(bank.Q, s * modes + i, n, n)
                fit = meet(sizes, F, Q, j, i, now, later, pair) + np.log(now.mu[j] * T[j, i])
                sums.share[j, i] = fit
                best = max(best, fit)
        for j in range(modes):
            sums.share[j, i] = np.exp(sums.share[j, i] - best) if sums.share[j, i] > _LEAST else 0.0
            total += sums.share[j, i]
        for j in range(modes):
            sums.share[j, i] *= later.mu[i] / total if total > 0.0 else 0.0


@compiled_part
def gather(sizes: BankSizes, j: int, total: float, sums: Sums, own: Beliefs) -> None:
    """Merge what all modes after it say of mode j."""
    n, modes = len(sizes.states), len(sizes.modes)
    for a in range(n):
        s = 0.0
        for i in range(modes):
            s += sums.share[j, i] * sums.x[i, a] if sums.share[j, i] > 0.0 else 0.0
        own.x[j, a] = s / total
    for a in range(n):
        for b in range(a + 1):
            s = 0.0
            for i in range(modes):
                if sums.share[j, i] > 0.0:
                    apart = (sums.x[i, a] - own.x[j, a]) * (sums.x[i, b] - own.x[j, b])
                    s += sums.share[j, i] * (sums.P[i, a * n + b] + apart)
            own.P[j, a * n + b] = s / total
            own.P[j, b * n + a] = s / total


@compiled_part
def smooth_row(  # noqa: PLR0913
    sizes: BankSizes, bank: Bank, s: int, now: Beliefs, later: Beliefs, own: Beliefs, pair: Pair, sums: Sums
) -> None:
    """Come back over step s: from `later`, smoothed, and `now`, filtered, tell `own`, smoothed."""
    n, modes = sizes.states, len(sizes.modes)
    share_out(sizes, bank, s, now, later, pair, sums)
    for j in range(modes):
        total = 0.0
        for i in range(modes):
            sums.share[j, i] = sums.share[j, i] if sums.share[j, i] > _NEGLIGIBLE else 0.0
            total += sums.share[j, i]
        own.mu[j] = max(total, UNLIKELY)
        for i in range(modes):
            if sums.share[j, i] > 0.0:
                F, Q = layer(bank.F, s * modes + i, n, n), layer(bank.Q, s * modes + i, n, n)
                meet(sizes, F, Q, j, i, now, later, pair)
                carry_back(sizes, F, Q, j, i, now, later, pair, sums)
        if total > 0.0:
            gather(sizes, j, total, sums, own)
        else:
            copy_mode(sizes, j, now, own)


@compiled_part
def copy_mode(sizes: BankSizes, j: int, source: Beliefs, target: Beliefs) -> None:
    """Copy what mode j believes, but for its probability."""
    for a in range(len(sizes.states)):
        target.x[j, a] = source.x[j, a]
    for a in range(len(sizes.squared)):
        target.P[j, a] = source.P[j, a]


@compiled
def switch_backward(  # noqa: PLR0913  (a door for Python)
    sizes: BankSizes, bank: Bank, steps: Integers, filtered: Floats, later: Floats, first: int, trace: SwitchingTrace
) -> None:
    """Smooth some rows, given the filtered beliefs after each, (N, K); they are written from row `first` on.

    `steps` (N + 1,) says which step precedes each row, and the one after them; `later` (K,) holds the smoothed
    beliefs of that one, or a first probability of 0 where there is none, and those of the first row when done.
    Rows before the first reading are left as they are.
    """
    now, after, own = new_beliefs(sizes), new_beliefs(sizes), new_beliefs(sizes)
    pair, sums = new_pair(sizes), new_sums(sizes)
    transfer_beliefs(sizes, after, later, LOAD)
    for k in range(len(filtered) - 1, -1, -1):
        transfer_beliefs(sizes, now, filtered[k], LOAD)
        if not now.mu[0] > 0.0:
            break
        if after.mu[0] > 0.0 and steps[k + 1] >= 0:
            smooth_row(sizes, bank, steps[k + 1], now, after, own, pair, sums)
        else:
            for j in range(len(sizes.modes)):
                copy_mode(sizes, j, now, own)
                own.mu[j] = now.mu[j]
        write_modes(sizes, bank, first + k, own, trace)
        for j in range(len(sizes.modes)):
            copy_mode(sizes, j, own, after)
            after.mu[j] = own.mu[j]
    transfer_beliefs(sizes, after, later, SAVE)
