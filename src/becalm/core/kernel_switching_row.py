"""A bank of filters that switches, one row in Numba: the twin of `switching_reference`.

Every mode has a filter of its own over the same n states. Before each row their beliefs are mixed by how
likely a switch is, then each predicts and updates, and the likelihood of the reading weighs them anew.
Of one channel. Source: Blom and Bar-Shalom, IEEE TAC-33 (1988) 780.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.compiling import compiled_part, woven
from becalm.core.kernel_settling import transfer_matrix, transfer_vector
from becalm.core.kernel_steps import LARGEST
from becalm.core.sized import Size, layer, size, stack_matrix, stack_vector

UNLIKELY = 1e-100  # no mode becomes less probable than this: none is ever locked out
SELDOM = 1e-8  # share below which a mode is not mixed in: one Gaussian cannot hold what is so far out and so rare
TOLD = 3  # numbers that each mode keeps of a reading, to smooth by
_LOG_ROOT_2_PI = 0.5 * np.log(2 * np.pi)
_FAR = 1e300


class BankSizes(NamedTuple):
    """The sizes of a bank, as kernels are specialised for them."""

    states: Size  # n
    modes: Size  # M
    squared: Size  # n n
    each: Size  # M n


class Bank(NamedTuple):
    """The steps of all modes, of u different lengths, and what reads after them."""

    F: Floats  # (u M, n, n) the modes of one length side by side
    Q: Floats  # (u M, n, n)
    T: Floats  # (u, M, M) probability of going from mode i to mode j over the step
    H: Floats  # (1, n)
    C: Floats  # (1, n) what of the state is signal
    R: Floats  # (M,)
    tail: Floats  # (M,) share of readings that are wild
    wild: Floats  # (2,) variance of wild readings, and 1 where they are not believed, else 0


class Beliefs(NamedTuple):
    """What each mode believes, and how probable it is; changed in place."""

    x: Floats  # (M, n)
    P: Floats  # (M, n n) row by row
    mu: Floats  # (M,)


def bank_sizes(states: int, modes: int) -> BankSizes:
    """Return the sizes of a bank in a form that kernels are specialised for."""
    return BankSizes(size(states), size(modes), size(states * states), size(modes * states))


def memory_length(states: int, modes: int) -> int:
    """Return how many numbers hold all beliefs."""
    return modes * (1 + states + states * states)


@woven
def new_beliefs(sizes: BankSizes) -> Beliefs:
    """Make room for beliefs on the stack."""
    n, modes, squared, _ = sizes
    return Beliefs(stack_matrix(modes, n), stack_matrix(modes, squared), stack_vector(modes))


@compiled_part
def transfer_beliefs(sizes: BankSizes, own: Beliefs, memory: Floats, saving: float) -> None:
    """Save beliefs in a row of memory, or load them."""
    at = transfer_vector(sizes.modes, own.mu, memory, 0, saving)
    at = transfer_matrix(sizes.modes, sizes.states, own.x, memory, at, saving)
    transfer_matrix(sizes.modes, sizes.squared, own.P, memory, at, saving)


@compiled_part
def come_from(sizes: BankSizes, T: Floats, j: int, now: Beliefs, w: Floats) -> float:
    """Equation (1): write how probable each mode was before one that is j now; return how probable j is."""
    modes, c = len(sizes.modes), 0.0
    for i in range(modes):
        w[i] = now.mu[i] * T[i, j]
        c += w[i]
    reached, kept = c > UNLIKELY, 0.0
    for i in range(modes):  # where no way leads to it: from whatever is believed
        w[i] = w[i] if reached else now.mu[i]
        w[i] = w[i] if w[i] > SELDOM * c else 0.0
        kept += w[i]
    for i in range(modes):
        w[i] /= kept
    return c if reached else UNLIKELY


@compiled_part
def mix(sizes: BankSizes, T: Floats, now: Beliefs, mixed: Beliefs) -> None:
    """Equations (2) and (3): what each mode starts from, had it just been switched to or stayed."""
    n, modes, w = len(sizes.states), len(sizes.modes), stack_vector(sizes.modes)
    for j in range(modes):
        mixed.mu[j] = come_from(sizes, T, j, now, w)
        for a in range(n):
            s = 0.0
            for i in range(modes):
                s += w[i] * now.x[i, a]
            mixed.x[j, a] = s
        for a in range(n):
            for b in range(a + 1):
                s = 0.0
                for i in range(modes):
                    apart = (now.x[i, a] - mixed.x[j, a]) * (now.x[i, b] - mixed.x[j, b])
                    s += w[i] * (now.P[i, a * n + b] + apart)
                s = min(max(s, -LARGEST), LARGEST)
                mixed.P[j, a * n + b] = s
                mixed.P[j, b * n + a] = s


@compiled_part
def predict_mode(sizes: BankSizes, F: Floats, Q: Floats, j: int, mixed: Beliefs, now: Beliefs) -> None:  # noqa: PLR0913
    """Equation (4) of one mode: x = F x, P = F P F' + Q."""
    n, FP = len(sizes.states), stack_matrix(sizes.states, sizes.states)
    for a in range(n):
        s = 0.0
        for k in range(n):
            s += F[a, k] * mixed.x[j, k]
        now.x[j, a] = min(max(s, -LARGEST), LARGEST)
        for b in range(n):
            s = 0.0
            for k in range(n):
                s += F[a, k] * mixed.P[j, k * n + b]
            FP[a, b] = s
    for a in range(n):
        for b in range(a + 1):
            s = Q[a, b]
            for k in range(n):
                s += FP[a, k] * F[b, k]
            now.P[j, a * n + b] = s
            now.P[j, b * n + a] = s


class Look(NamedTuple):
    """What each mode makes of a reading, on the stack."""

    Hx: Floats  # (M,) what it expected
    S: Floats  # (M,)
    weight: Floats  # (M,) likelihood, scaled alike for all
    far: Floats  # (M,) logarithm of it, where the reading is not wild
    wild: Floats  # (M,) share of it that a wild reading has


@woven
def new_look(sizes: BankSizes) -> Look:
    """Make room for a look on the stack."""
    return Look(
        stack_vector(sizes.modes), stack_vector(sizes.modes), stack_vector(sizes.modes), stack_vector(sizes.modes),
        stack_vector(sizes.modes),
    )  # fmt: skip


@compiled_part
def foresee(sizes: BankSizes, bank: Bank, now: Beliefs, look: Look) -> None:
    """Equation (5): what each mode expects to be read, and how closely."""
    n, H = len(sizes.states), bank.H
    for j in range(len(sizes.modes)):
        s, y = bank.R[j], 0.0
        for a in range(n):
            y += H[0, a] * now.x[j, a]
            for b in range(n):
                s += H[0, a] * H[0, b] * now.P[j, a * n + b]
        look.Hx[j], look.S[j] = y, s


@compiled_part
def judge_modes(sizes: BankSizes, bank: Bank, z: float, look: Look) -> float:
    """Equation (6): how likely the reading is to each mode, but for exp(-best), which is returned."""
    V, best = bank.wild[0], _FAR
    for j in range(len(sizes.modes)):
        nu = z - look.Hx[j]
        look.weight[j] = 0.5 * nu * nu / look.S[j]
        best = min(best, look.weight[j])
        if bank.tail[j] > 0.0:
            look.wild[j] = 0.5 * nu * nu / (look.S[j] + V)
            best = min(best, look.wild[j])
    for j in range(len(sizes.modes)):
        t, wild = bank.tail[j], 0.0
        look.far[j] = best - look.weight[j] + np.log((1.0 - t) / np.sqrt(look.S[j]))
        tame = np.exp(look.far[j])
        if t > 0.0:
            wild = t * np.exp(best - look.wild[j]) / np.sqrt(look.S[j] + V)
        look.weight[j] = tame + wild
        look.wild[j] = wild / (tame + wild) if wild > 0.0 else 0.0
    return best


@compiled_part
def shrink_mode(sizes: BankSizes, H: Floats, K: Floats, j: int, now: Beliefs, AP: Floats, A: Floats) -> None:  # noqa: PLR0913
    """Write A = I - K H and A P of one mode."""
    n = len(sizes.states)
    for a in range(n):
        for b in range(n):
            A[a, b] = (1.0 if a == b else 0.0) - K[a] * H[0, b]
    for a in range(n):
        for b in range(n):
            s = 0.0
            for k in range(n):
                s += A[a, k] * now.P[j, k * n + b]
            AP[a, b] = s


@compiled_part
def gain_of_mode(sizes: BankSizes, H: Floats, S: float, j: int, now: Beliefs, K: Floats) -> None:  # noqa: PLR0913
    """Write the gain of one mode."""
    n, share = len(sizes.states), 1.0 / S if S > 0.0 else 0.0
    for a in range(n):
        s = 0.0
        for b in range(n):
            s += now.P[j, a * n + b] * H[0, b]
        K[a] = s * share


@compiled_part
def correct_mode(sizes: BankSizes, bank: Bank, z: float, j: int, look: Look, now: Beliefs) -> None:  # noqa: PLR0913
    """Equation (7) of one mode, Joseph's form; of a reading that may be wild, the mixture of both outcomes."""
    n, R, K = len(sizes.states), bank.R[j], stack_vector(sizes.states)
    A, AP = stack_matrix(sizes.states, sizes.states), stack_matrix(sizes.states, sizes.states)
    nu, w = z - look.Hx[j], 1.0 - look.wild[j] * bank.wild[1]
    gain_of_mode(sizes, bank.H, look.S[j], j, now, K)
    shrink_mode(sizes, bank.H, K, j, now, AP, A)
    spread = w * (1.0 - w) * nu * nu
    for a in range(n):
        now.x[j, a] += w * K[a] * nu
        for b in range(a + 1):
            s = K[a] * K[b] * R
            for k in range(n):
                s += AP[a, k] * A[b, k]
            s = w * s + (1.0 - w) * now.P[j, a * n + b] + spread * K[a] * K[b]
            now.P[j, a * n + b] = s
            now.P[j, b * n + a] = s


@compiled_part
def weigh_modes(sizes: BankSizes, look: Look, mixed: Beliefs, now: Beliefs) -> float:
    """Equation (8): how probable each mode is after the reading; returns the likelihood, scaled."""
    total = 0.0
    for j in range(len(sizes.modes)):
        now.mu[j] = mixed.mu[j] * look.weight[j]
        total += now.mu[j]
    possible = total > 1.0 / _FAR
    share = 1.0 / total if possible else 1.0
    for j in range(len(sizes.modes)):  # a reading that no mode can explain tells nothing of them
        now.mu[j] = max(now.mu[j] * share if possible else mixed.mu[j], UNLIKELY)
    return total if possible else 1.0 / _FAR


@compiled_part
def begin_modes(sizes: BankSizes, z: float, start: Floats, now: Beliefs) -> None:
    """Begin with the first reading: `start` (M, 1 + n) has each mode's probability and the variances of its states."""
    n = len(sizes.states)
    for j in range(len(sizes.modes)):
        now.mu[j] = start[j, 0]
        for a in range(n):
            now.x[j, a] = z if a == 0 else 0.0
            for b in range(n):
                now.P[j, a * n + b] = start[j, 1 + a] if a == b else 0.0


@compiled_part
def step_modes(sizes: BankSizes, bank: Bank, s: int, now: Beliefs, mixed: Beliefs) -> None:
    """Mix and predict all modes over step s."""
    n, modes = sizes.states, len(sizes.modes)
    mix(sizes, layer(bank.T, s, sizes.modes, sizes.modes), now, mixed)
    for j in range(modes):
        at = s * modes + j
        predict_mode(sizes, layer(bank.F, at, n, n), layer(bank.Q, at, n, n), j, mixed, now)


@compiled_part
def take_modes(sizes: BankSizes, bank: Bank, z: float, look: Look, mixed: Beliefs, now: Beliefs) -> float:  # noqa: PLR0913
    """Take a reading that arrived; return its log-likelihood."""
    best = judge_modes(sizes, bank, z, look)
    for j in range(len(sizes.modes)):
        correct_mode(sizes, bank, z, j, look, now)
    log_likelihood: float = np.log(weigh_modes(sizes, look, mixed, now)) - best - _LOG_ROOT_2_PI
    return log_likelihood
