"""A bank that switches, smoothed: coming back, each mode is told what the later readings said.

For every pair of a mode before a step and a mode after it, the filtered belief of the one meets what the later
readings say to the other; the pair is as probable as its forward probability times how well they agree. So a jump
that only later readings reveal is found. What they say to a mode, over all modes after it, is pooled into one
likelihood by the mean of their logarithms, each weighed by how probable it is: that keeps every covariance
positive and below the filtered one, where the moments of the mixture would not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_matrices import multiply
from becalm.core.kernel_switching_ahead import (
    Outlook,
    Return,
    factor_beside_one,
    pack,
    root,
    shrink_outlook,
    solve_lower,
    solve_upper,
    turn_outlook,
    unpack,
)
from becalm.core.kernel_switching_row import TOLD, UNLIKELY, Bank, BankSizes, Beliefs
from becalm.core.sized import Size, layer, stack_matrix, stack_vector

_NEGLIGIBLE = 1e-16  # share of a pair that is not looked at
_LEAST = -1e300  # a logarithm below any


class Pairs(NamedTuple):
    """What is gathered of pairs of modes, [before, after], on the stack."""

    fit: Floats  # (M, M) logarithm of the probability of a pair, but for a constant; then its share of the mode before
    r: Floats  # (M n, M) what the mode after says of the state of the one before
    Y: Floats  # (M, n n) how surely
    x: Floats  # (M, n) the state of one mode before, with each after it
    P: Floats  # (M, n n)
    G: Floats  # (M, n n) of each mode before, P = G G'


@woven
def new_pairs(sizes: BankSizes) -> Pairs:
    """Make room for pairs on the stack."""
    n, modes, squared, each = sizes
    return Pairs(
        stack_matrix(modes, modes), stack_matrix(each, modes), stack_matrix(modes, squared),
        stack_matrix(modes, n), stack_matrix(modes, squared), stack_matrix(modes, squared),
    )  # fmt: skip


@compiled_part
def take_back(sizes: BankSizes, bank: Bank, note: Floats, now: Beliefs, ahead: Outlook) -> None:
    """Equation (9): add what the reading of a row said to what later ones say; all of it is about the mean."""
    n, at, best = len(sizes.states), len(note) - TOLD * len(sizes.modes), _LEAST
    ahead.known[0] = 1.0
    for j in range(len(sizes.modes)):
        for a in range(n):
            ahead.c[j, a] = now.x[j, a]
            ahead.r[j, a] += note[at] * bank.H[0, a]
            for b in range(n):
                ahead.Y[j, a * n + b] += note[at + 1] * bank.H[0, a] * bank.H[0, b]
        ahead.g[j] += note[at + 2]
        best = max(best, ahead.g[j])
        at += TOLD
    for j in range(len(sizes.modes)):
        ahead.g[j] -= best


@compiled_part
def agree(  # noqa: PLR0913
    states: Size, G: Floats, Y: Floats, r: Floats, share: float, L: Floats, D: Floats, v: Floats
) -> float:
    """Equation (12): how well a belief P = G G' agrees with r and Y about its mean, as a log-likelihood, times a share.

    Writes the factors of I + G' Y G and v = (I + G' Y G)^-1 G' r, so that G v is what the mean moves by.
    """
    n, YG = len(states), stack_matrix(states, states)
    multiply(states, states, Y, G, YG)
    logarithm, product = factor_beside_one(states, G, YG, L, D)
    fit: float = np.log(share / np.sqrt(product)) - 0.5 * logarithm
    for a in range(n):
        s = 0.0
        for k in range(n):
            s += G[k, a] * r[k]
        v[a] = s
    solve_lower(states, L, v)
    for a in range(n):
        u = v[a]
        v[a] = u / D[a]
        fit += 0.5 * u * v[a]
    solve_upper(states, L, v)
    return fit


@compiled_part
def meet_pairs(  # noqa: PLR0913
    sizes: BankSizes, bank: Bank, s: int, now: Beliefs, ahead: Outlook, way: Return, pairs: Pairs
) -> float:
    """Equations (10) to (12) of all pairs; return the largest fit."""
    n, modes, states = len(sizes.states), len(sizes.modes), sizes.states
    T, best = layer(bank.T, s, sizes.modes, sizes.modes), _LEAST
    L, D, v = stack_matrix(states, states), stack_vector(states), stack_vector(states)
    x, r, G, P = stack_vector(states), stack_vector(states), stack_matrix(states, states), stack_matrix(states, states)
    for j in range(modes):
        unpack(states, now.P, j, G)
        root(states, G, P)
        pack(states, P, pairs.G, j)
    for i in range(modes):
        F, Q = layer(bank.F, s * modes + i, states, states), layer(bank.Q, s * modes + i, states, states)
        half = 0.5 * shrink_outlook(sizes, F, Q, i, ahead, way)
        pack(states, way.Y, pairs.Y, i)
        for j in range(modes):
            for a in range(n):
                x[a] = now.x[j, a]
            share = max(now.mu[j] * T[j, i], UNLIKELY * UNLIKELY)
            fit = turn_outlook(sizes, F, i, ahead, way, x, r) - half
            unpack(states, pairs.G, j, G)
            fit += agree(states, G, way.Y, r, share, L, D, v)
            for a in range(n):
                pairs.r[j * n + a, i] = r[a]
            pairs.fit[j, i] = fit if fit > _LEAST and fit < -_LEAST else _LEAST
            best = max(best, pairs.fit[j, i])
    return best


@compiled_part
def smooth_mode(sizes: BankSizes, j: int, now: Beliefs, pairs: Pairs, own: Beliefs) -> None:
    """Equation (13): the smoothed state of mode j, merged over all modes after it."""
    n, modes, states = len(sizes.states), len(sizes.modes), sizes.states
    L, D, v = stack_matrix(states, states), stack_vector(states), stack_vector(states)
    r, G, Y = stack_vector(states), stack_matrix(states, states), stack_matrix(states, states)
    unpack(states, pairs.G, j, G)
    for a in range(n):
        own.x[j, a] = 0.0
    for i in range(modes):
        if not pairs.fit[j, i] * own.mu[j] > _NEGLIGIBLE:
            continue
        for a in range(n):
            r[a] = pairs.r[j * n + a, i]
        unpack(states, pairs.Y, i, Y)
        agree(states, G, Y, r, 1.0, L, D, v)
        for a in range(n):
            s = now.x[j, a]
            for k in range(n):
                s += G[a, k] * v[k]
            pairs.x[i, a] = s
            own.x[j, a] += pairs.fit[j, i] * s
        write_spread(sizes, i, G, L, D, pairs)
    merge_spreads(sizes, j, pairs, own)


@compiled_part
def merge_spreads(sizes: BankSizes, j: int, pairs: Pairs, own: Beliefs) -> None:
    """Write the covariance of mode j, smoothed, once its mean is known."""
    n, modes = len(sizes.states), len(sizes.modes)
    for a in range(n):
        for b in range(a + 1):
            s = 0.0
            for i in range(modes):
                if pairs.fit[j, i] * own.mu[j] > _NEGLIGIBLE:
                    apart = (pairs.x[i, a] - own.x[j, a]) * (pairs.x[i, b] - own.x[j, b])
                    s += pairs.fit[j, i] * (pairs.P[i, a * n + b] + apart)
            own.P[j, a * n + b] = s
            own.P[j, b * n + a] = s


@compiled_part
def write_spread(sizes: BankSizes, i: int, G: Floats, L: Floats, D: Floats, pairs: Pairs) -> None:  # noqa: PLR0913
    """Write the covariance of a pair, G (I + G' Y G)^-1 G'."""
    n, W, row = len(sizes.states), stack_matrix(sizes.states, sizes.states), stack_vector(sizes.states)
    for b in range(n):
        for a in range(n):
            row[a] = G[b, a]
        solve_lower(sizes.states, L, row)
        for a in range(n):
            W[a, b] = row[a]
    for a in range(n):
        for b in range(a + 1):
            s = 0.0
            for k in range(n):
                s += W[k, a] * W[k, b] / D[k]
            pairs.P[i, a * n + b] = s
            pairs.P[i, b * n + a] = s


@compiled_part
def pool(sizes: BankSizes, j: int, evidence: float, pairs: Pairs, ahead: Outlook) -> None:
    """Equation (14): what all modes after it say to mode j, as one likelihood, as likely as all of them."""
    n, modes, states = len(sizes.states), len(sizes.modes), sizes.states
    L, D, v = stack_matrix(states, states), stack_vector(states), stack_vector(states)
    Y, r, G = stack_matrix(states, states), stack_vector(states), stack_matrix(states, states)
    for a in range(n):
        s = 0.0
        for i in range(modes):
            s += pairs.fit[j, i] * pairs.r[j * n + a, i]
        r[a] = s
        ahead.r[j, a] = s
        for b in range(n):
            s = 0.0
            for i in range(modes):
                s += pairs.fit[j, i] * pairs.Y[i, a * n + b]
            Y[a, b] = s
    pack(states, Y, ahead.Y, j)
    unpack(states, pairs.G, j, G)
    ahead.g[j] = evidence - agree(states, G, Y, r, 1.0, L, D, v)


@compiled_part
def smooth_row(  # noqa: PLR0913
    sizes: BankSizes, bank: Bank, s: int, now: Beliefs, ahead: Outlook, way: Return, pairs: Pairs, own: Beliefs
) -> None:
    """Come back over step s: from `ahead`, of the row after it, and `now`, filtered, tell `own` and `ahead`."""
    modes, every = len(sizes.modes), 0.0
    best = meet_pairs(sizes, bank, s, now, ahead, way, pairs)
    evidence = stack_vector(sizes.modes)
    for j in range(modes):
        highest, total = _LEAST, 0.0
        for i in range(modes):
            highest = max(highest, pairs.fit[j, i])
        for i in range(modes):
            pairs.fit[j, i] = np.exp(pairs.fit[j, i] - highest)
            total += pairs.fit[j, i]
        for i in range(modes):
            pairs.fit[j, i] /= total
        evidence[j] = highest + np.log(total / now.mu[j])
        own.mu[j] = total * np.exp(highest - best)
        every += own.mu[j]
    for j in range(modes):
        own.mu[j] = max(own.mu[j] / every, UNLIKELY)
        if own.mu[j] > _NEGLIGIBLE:
            smooth_mode(sizes, j, now, pairs, own)
        else:
            copy_mode(sizes, j, now, own)
        pool(sizes, j, evidence[j], pairs, ahead)


@compiled_part
def copy_mode(sizes: BankSizes, j: int, source: Beliefs, target: Beliefs) -> None:
    """Copy what mode j believes, but for its probability."""
    for a in range(len(sizes.states)):
        target.x[j, a] = source.x[j, a]
    for a in range(len(sizes.squared)):
        target.P[j, a] = source.P[j, a]


@compiled_part
def end_of_record(sizes: BankSizes, now: Beliefs, ahead: Outlook, own: Beliefs) -> None:
    """Tell of a row that nothing follows."""
    for j in range(len(sizes.modes)):
        copy_mode(sizes, j, now, own)
        own.mu[j] = now.mu[j]
        ahead.g[j] = 0.0
        for a in range(len(sizes.states)):
            ahead.r[j, a] = 0.0
        for a in range(len(sizes.squared)):
            ahead.Y[j, a] = 0.0
