"""The specification of a bank that switches, in plain NumPy with numbered equations; never optimised.

It computes in the precision of the arrays it is given, which may be long double. The kernels are its twins and must
agree with it to 1e-10. Forward it is the interacting multiple model of Blom
and Bar-Shalom, IEEE TAC-33 (1988) 780, with readings that may be wild. Coming back it is the two-filter smoother of
Fraser and Potter, IEEE TAC-14 (1969) 387, for every pair of modes before and after a step: filtered beliefs meet
what later readings say, a likelihood exp(g + r' (h - c) - (h - c)' Y (h - c) / 2) of the state h in each mode.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from becalm.core.arrays import Floats
from becalm.native.imm import Bank, Steps

_READABLE = 1e100  # no sensor reads more
_UNLIKELY = 1e-100  # no mode becomes less probable
_SELDOM = 1e-8  # weight below which nothing is mixed in


class Beliefs(NamedTuple):
    """What each mode believes, and how probable it is."""

    x: Floats  # (M, n)
    P: Floats  # (M, n, n)
    mu: Floats  # (M,)


class Outlook(NamedTuple):
    """What readings from a row on say of it, to each mode."""

    c: Floats  # (M, n)
    r: Floats  # (M, n)
    Y: Floats  # (M, n, n)
    g: Floats  # (M,)


class Row(NamedTuple):
    """What is believed after a reading, and what it taught."""

    beliefs: Beliefs
    said: Outlook  # by the reading alone, about the mean after it
    log_likelihood: float  # 0 of a reading that did not arrive, and of the first
    wild: float  # probability that the reading is wild; NaN where none was judged
    innovation: float  # of the mixture: normal score times innovation_sigma; NaN where none was judged
    innovation_sigma: float


class Modes(NamedTuple):
    """The modes over one step."""

    F: Floats  # (M, n, n)
    Q: Floats  # (M, n, n)
    T: Floats  # (M, M)


def modes_over(bank: Bank, step: int) -> Modes:
    """Return the modes over the step of that number."""
    own = slice(step * len(bank.R), (step + 1) * len(bank.R))
    return Modes(bank.F[own], bank.Q[own], bank.T[step])


def begin(z: float, start: Floats) -> Beliefs:
    """Begin with the first reading: `start` (M, 1 + n) has each mode's probability, and its states' variances."""
    x = np.zeros_like(start[:, 1:])
    x[:, 0] = z
    return Beliefs(x, np.array([np.diag(variances) for variances in start[:, 1:]]), start[:, 0].copy())


def collapse(weights: Floats, x: Floats, P: Floats) -> tuple[Floats, Floats]:
    """Return mean and covariance of a mixture: weights (K,), means (K, n), covariances (K, n, n)."""
    mean = weights @ x
    apart = x - mean
    return mean, np.einsum("k,kab->ab", weights, P + apart[:, :, np.newaxis] * apart[:, np.newaxis, :])


def mix(now: Beliefs, T: Floats) -> Beliefs:
    """Tell what each mode starts a step from, had it just been switched to or stayed."""
    c = now.mu @ T  # (1)
    weights = [_often(now.mu * T[:, j] / c[j] if c[j] > _UNLIKELY else now.mu) for j in range(len(c))]
    parts = [collapse(weight, now.x, now.P) for weight in weights]  # (2), (3)
    return Beliefs(np.array([x for x, _ in parts]), np.array([P for _, P in parts]), np.maximum(c, _UNLIKELY))


def _often(weights: Floats) -> Floats:
    """Return the weights of a mixture without the least of them."""
    kept = np.where(weights > _SELDOM, weights, 0.0)
    often: Floats = kept / kept.sum()
    return often


def predict(mixed: Beliefs, modes: Modes) -> Beliefs:
    """Carry each mode over the step."""
    x = np.array([F @ own for F, own in zip(modes.F, mixed.x, strict=True)])  # (4)
    P = np.array([F @ own @ F.T + Q for F, Q, own in zip(modes.F, modes.Q, mixed.P, strict=True)])
    return Beliefs(x, P, mixed.mu)


def update(before: Beliefs, bank: Bank, z: float) -> Row:
    """Learn from a reading, which each mode takes for tame or wild."""
    H, R, tail, (V, rejects) = bank.H[0], bank.R, bank.tail, bank.wild
    nu, S = z - before.x @ H, np.einsum("a,jab,b->j", H, before.P, H) + R  # (5)
    tame, wild = (1 - tail) * normal(nu, S), tail * normal(nu, S + V)  # (6)
    likelihood = tame + wild
    w = 1 - wild / likelihood * rejects
    parts = [corrected((before.x[j], before.P[j]), (H, R[j]), z, w[j]) for j in range(len(R))]
    total = before.mu @ likelihood
    mu = np.maximum(before.mu * likelihood / total, _UNLIKELY)  # (8)
    expected = before.mu @ (before.x @ H)
    spread = before.mu @ (S + (before.x @ H - expected) ** 2)
    after = Beliefs(np.array([x for x, _ in parts]), np.array([P for _, P in parts]), mu)
    said = reading_says(after, bank, z, w / R)
    fit = np.array([evidence(before.x[j], before.P[j], said, j) for j in range(len(R))])
    said = said._replace(g=np.log(likelihood) - fit)  # so that each mode finds it as likely as it was weighed
    below, above = (float(before.mu @ foretold(side * nu, S, V, tail)) for side in (1, -1))
    score = float(ndtri(below)) if below < above else -float(ndtri(above))
    judged = float(mu @ (wild / likelihood)), score * float(spread**0.5), float(spread**0.5)
    return Row(after, said, float(np.log(total)), *judged)


def foretold(nu: Floats, S: Floats, V: float, tail: Floats) -> Floats:
    """Return how probable a smaller innovation is to each mode, (M,)."""
    tame, wild = (np.asarray(nu / np.sqrt(variance), np.float64) for variance in (S, S + V))  # ndtr knows no other
    probability: Floats = (1 - tail) * ndtr(tame) + tail * ndtr(wild)
    return probability


def corrected(one: tuple[Floats, Floats], sensor: tuple[Floats, float], z: float, w: float) -> tuple[Floats, Floats]:
    """Return what one mode believes after a reading that is to be believed with probability w."""
    x, P = one
    H, R = sensor
    K = P @ H / (H @ P @ H + R)
    A = np.eye(len(x)) - np.outer(K, H)
    learned, shrunk = x + K * (z - H @ x), A @ P @ A.T + R * np.outer(K, K)
    return collapse(np.array([w, 1 - w]), np.array([learned, x]), np.array([shrunk, P]))  # (7)


def normal(nu: Floats, S: Floats) -> Floats:
    """Return the density of zero-mean normal numbers nu of variance S."""
    density: Floats = np.exp(-0.5 * nu**2 / S) / np.sqrt(2 * np.pi * S)
    return density


def filter_readings(bank: Bank, start: Floats, z: Floats, steps: Steps) -> list[Row]:
    """Run over z (N,); `steps` (N,) says which step precedes each row, -1 for none."""
    rows: list[Row] = []
    beliefs: Beliefs | None = None
    for reading, step in zip(z, steps, strict=True):
        arrived = bool(np.abs(reading) <= _READABLE)
        if beliefs is None:
            beliefs = begin(reading, start) if arrived else None
            unknown = Beliefs(*(np.full_like(a, np.nan) for a in begin(0.0, start)))
            row = _unread(unknown if beliefs is None else beliefs)
        else:
            if step >= 0:
                modes = modes_over(bank, step)
                beliefs = predict(mix(beliefs, modes.T), modes)
            row = update(beliefs, bank, reading) if arrived else _unread(beliefs)
            beliefs = row.beliefs
        rows.append(row)
    return rows


def _unread(beliefs: Beliefs) -> Row:
    """Return a row whose reading taught nothing."""
    return Row(beliefs, _nothing(beliefs), 0.0, np.nan, np.nan, np.nan)


def _nothing(now: Beliefs) -> Outlook:
    return Outlook(now.x, np.zeros_like(now.x), np.zeros_like(now.P), np.zeros_like(now.mu))


def reading_says(after: Beliefs, bank: Bank, z: float, W: Floats) -> Outlook:
    """Return what a reading of weights W (M,), 1 / R where it is believed, says about the mean after it."""
    H = bank.H[0]
    r = np.array([H * own * (z - H @ x) for own, x in zip(W, after.x, strict=True)])
    Y = np.array([np.outer(H, H) * own for own in W])
    return Outlook(after.x, r, Y, np.zeros_like(W))  # (9)


def solve(A: Floats, B: Floats) -> tuple[Floats, Any]:
    """Return A^-1 B and log |A|, by Gauss and Jordan, in whatever precision they are given."""
    n, rows, logarithm = len(A), np.hstack([A, B]), A.dtype.type(0)
    for c in range(n):
        p = c + int(np.abs(rows[c:, c]).argmax())
        rows[[c, p]] = rows[[p, c]]
        logarithm += np.log(np.abs(rows[c, c]))
        rows[c] /= rows[c, c]
        others = np.arange(n) != c
        rows[others] -= np.outer(rows[others, c], rows[c])
    return rows[:, n:], logarithm


def evidence(x: Floats, P: Floats, ahead: Outlook, i: int) -> Any:
    """Return how well a belief agrees with what is said to mode i, as a log-likelihood."""
    c, r, Y, g = (part[i] for part in ahead)
    d = x - c
    q = r - Y @ d  # the slope at x
    moved, determinant = solve(np.eye(len(x)) + P @ Y, (P @ q)[:, np.newaxis])
    return g + r @ d - d @ Y @ d / 2 + q @ moved[:, 0] / 2 - determinant / 2  # (12)


def before_step(F: Floats, Q: Floats, x: Floats, ahead: Outlook, i: int) -> Outlook:
    """Return what is said, about x, of the state before a step into mode i; of that mode alone, no axis for it."""
    c, r, Y, _ = (part[i] for part in ahead)
    A, _ = solve(np.eye(len(x)) + Y @ Q, np.eye(len(x)))
    own = evidence(F @ x, Q, ahead, i)  # of a state that begins at x
    return Outlook(x, F.T @ A @ (r - Y @ (F @ x - c)), F.T @ A @ Y @ F, np.array(own))  # (10), (11)


def smooth(bank: Bank, rows: list[Row], steps: Steps) -> list[Beliefs]:
    """Go back over a filtered record; each belief then knows the later readings too."""
    smoothed: list[Beliefs] = []
    ahead: Outlook | None = None
    for k in range(len(rows) - 1, -1, -1):
        now, said = rows[k].beliefs, rows[k].said
        if ahead is None or steps[k + 1] < 0 or np.isnan(now.mu[0]):
            own, pooled = now, _nothing(now)
        else:
            own, pooled = smooth_row(now, modes_over(bank, steps[k + 1]), ahead)
        smoothed.append(own)
        ahead = Outlook(now.x, pooled.r + said.r, pooled.Y + said.Y, pooled.g + said.g)  # (9)
    return smoothed[::-1]


def smooth_row(now: Beliefs, modes: Modes, ahead: Outlook) -> tuple[Beliefs, Outlook]:
    """Return what is believed of a row given later readings too, and what they say to each mode."""
    parts = [smooth_mode(now, modes, ahead, j) for j in range(len(now.mu))]
    fit = np.array([own for *_, own in parts]) + np.log(now.mu)
    mu = np.exp(fit - fit.max())
    x, P = (np.array(arrays) for arrays in list(zip(*parts, strict=True))[:2])
    pooled = Outlook(*(np.array(arrays) for arrays in zip(*(said for _, _, said, _ in parts), strict=True)))
    return Beliefs(x, P, np.maximum(mu / mu.sum(), _UNLIKELY)), pooled


def smooth_mode(now: Beliefs, modes: Modes, ahead: Outlook, j: int) -> tuple[Floats, Floats, Outlook, Any]:
    """Return mean and covariance of mode j, what later readings say to it, and how likely it finds them."""
    x, P, n, count = now.x[j], now.P[j], now.x.shape[1], len(now.mu)
    said = [before_step(modes.F[i], modes.Q[i], x, ahead, i) for i in range(count)]
    every = Outlook(*(np.array(arrays) for arrays in zip(*said, strict=True)))
    fit = np.array([evidence(x, P, every, i) for i in range(count)])
    fit += np.log(np.maximum(now.mu[j] * modes.T[j], _UNLIKELY**2)) - np.log(now.mu[j])
    weight = np.exp(fit - fit.max())
    likely, weight = np.log(weight.sum()) + fit.max(), weight / weight.sum()
    shrunk = np.array([solve(np.eye(n) + P @ Y, P)[0] for Y in every.Y])
    mean, cov = collapse(weight, x + np.einsum("iab,ib->ia", shrunk, every.r), shrunk)  # (13)
    r, Y = weight @ every.r, np.einsum("i,iab->ab", weight, every.Y)
    alone = Outlook(x[np.newaxis], r[np.newaxis], Y[np.newaxis], np.zeros(1))
    return mean, cov, Outlook(x, r, Y, np.array(likely - evidence(x, P, alone, 0))), likely  # (14)
