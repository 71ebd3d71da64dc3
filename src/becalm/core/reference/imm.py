"""The reference filter and smoother of interacting multiple models (IMM), in plain NumPy with numbered equations.

This module is never optimised. It computes in the precision of its input arrays, which may be long double. The kernels
must agree with it to 1e-10. The filter is the interacting multiple model of Blom and Bar-Shalom, IEEE TAC-33 (1988)
780, with a second, wider distribution for outliers. Outliers are called wild readings, all other readings tame. The
smoother is the two-filter smoother of Fraser and Potter, IEEE TAC-14 (1969) 387, for every pair of modes before and
after a step. It combines the filtered state with the likelihood of the later readings. As a function of
the state h in each mode this likelihood is exp(g + r' (h - c) - (h - c)' Y (h - c) / 2).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from becalm.core.arrays import Floats
from becalm.native.imm import ModeMatrices, Steps

_READABLE = 1e100  # largest magnitude of a reading; no sensor measures more
_UNLIKELY = 1e-100  # lower limit of the probability of a mode
_NEGLIGIBLE = 1e-8  # a mixture leaves out parts with a smaller weight


class ModeStates(NamedTuple):
    """State, covariance and probability of each mode."""

    x: Floats  # (M, n)
    P: Floats  # (M, n, n)
    mu: Floats  # (M,)


class BackwardLikelihood(NamedTuple):
    """Likelihood of the readings from a row on, as a function of the state in each mode; see the module docstring."""

    c: Floats  # (M, n) centre
    r: Floats  # (M, n) gradient at c
    Y: Floats  # (M, n, n) information
    g: Floats  # (M,) log-likelihood at c


class Row(NamedTuple):
    """The posterior after a reading, and quantities that depend on the reading."""

    posterior: ModeStates
    likelihood: BackwardLikelihood  # likelihood of this reading, with the posterior mean as centre
    log_likelihood: float  # 0 for a missing reading and for the first reading
    wild: float  # probability that the reading is wild; NaN if there was no update
    innovation: float  # normal score of the reading times innovation_sigma; NaN if there was no update
    innovation_sigma: float  # standard deviation of the predicted mixture; NaN if there was no update


class Modes(NamedTuple):
    """The matrices of the modes over one step."""

    F: Floats  # (M, n, n)
    Q: Floats  # (M, n, n)
    T: Floats  # (M, M) probability of going from mode i to mode j


def modes_over(matrices: ModeMatrices, step: int) -> Modes:
    """Return the matrices of the modes for the step with a given index."""
    own = slice(step * len(matrices.R), (step + 1) * len(matrices.R))
    return Modes(matrices.F[own], matrices.Q[own], matrices.T[step])


def begin(z: float, start: Floats) -> ModeStates:
    """Start at the first reading; `start` (M, 1 + n) holds the probability of each mode and the variances of states."""
    x = np.zeros_like(start[:, 1:])
    x[:, 0] = z
    return ModeStates(x, np.array([np.diag(variances) for variances in start[:, 1:]]), start[:, 0].copy())


def collapse(weights: Floats, x: Floats, P: Floats) -> tuple[Floats, Floats]:
    """Return mean and covariance of a mixture: weights (K,), means (K, n), covariances (K, n, n)."""
    mean = weights @ x
    d = x - mean
    return mean, np.einsum("k,kab->ab", weights, P + d[:, :, np.newaxis] * d[:, np.newaxis, :])


def mix(now: ModeStates, T: Floats) -> ModeStates:
    """Return the mixed state of each mode before a step: all modes, weighted by their transitions into this mode."""
    c = now.mu @ T  # (1)
    weights = [_without_negligible(now.mu * T[:, j] / c[j] if c[j] > _UNLIKELY else now.mu) for j in range(len(c))]
    parts = [collapse(weight, now.x, now.P) for weight in weights]  # (2), (3)
    return ModeStates(np.array([x for x, _ in parts]), np.array([P for _, P in parts]), np.maximum(c, _UNLIKELY))


def _without_negligible(weights: Floats) -> Floats:
    """Return the normalised weights of a mixture without the negligible ones."""
    kept = np.where(weights > _NEGLIGIBLE, weights, 0.0)
    normalised: Floats = kept / kept.sum()
    return normalised


def predict(mixed: ModeStates, modes: Modes) -> ModeStates:
    """Predict the state of each mode over a step."""
    x = np.array([F @ own for F, own in zip(modes.F, mixed.x, strict=True)])  # (4)
    P = np.array([F @ own @ F.T + Q for F, Q, own in zip(modes.F, modes.Q, mixed.P, strict=True)])
    return ModeStates(x, P, mixed.mu)


def update(before: ModeStates, matrices: ModeMatrices, z: float) -> Row:
    """Update all modes with a reading that may be tame or wild."""
    H, R, tail, (V, rejects) = matrices.H[0], matrices.R, matrices.tail, matrices.wild
    nu, S = z - before.x @ H, np.einsum("a,jab,b->j", H, before.P, H) + R  # (5)
    tame, wild = (1 - tail) * normal(nu, S), tail * normal(nu, S + V)  # (6)
    likelihood = tame + wild
    w = 1 - wild / likelihood * rejects
    parts = [corrected((before.x[j], before.P[j]), (H, R[j]), z, w[j]) for j in range(len(R))]
    total = before.mu @ likelihood
    mu = np.maximum(before.mu * likelihood / total, _UNLIKELY)  # (8)
    expected = before.mu @ (before.x @ H)
    spread = before.mu @ (S + (before.x @ H - expected) ** 2)
    after = ModeStates(np.array([x for x, _ in parts]), np.array([P for _, P in parts]), mu)
    of_reading = reading_likelihood(after, matrices, z, w / R)
    fit = np.array([evidence(before.x[j], before.P[j], of_reading, j) for j in range(len(R))])
    of_reading = of_reading._replace(g=np.log(likelihood) - fit)  # its evidence is now `likelihood`
    below, above = (float(before.mu @ predicted_probability(side * nu, S, V, tail)) for side in (1, -1))
    score = float(ndtri(below)) if below < above else -float(ndtri(above))
    judged = float(mu @ (wild / likelihood)), score * float(spread**0.5), float(spread**0.5)
    return Row(after, of_reading, float(np.log(total)), *judged)


def predicted_probability(nu: Floats, S: Floats, V: float, tail: Floats) -> Floats:
    """Return the predicted probability of a smaller innovation in each mode, (M,)."""
    tame, wild = (np.asarray(nu / np.sqrt(variance), np.float64) for variance in (S, S + V))  # ndtr takes float64 only
    probability: Floats = (1 - tail) * ndtr(tame) + tail * ndtr(wild)
    return probability


def corrected(one: tuple[Floats, Floats], sensor: tuple[Floats, float], z: float, w: float) -> tuple[Floats, Floats]:
    """Return the posterior of one mode after a reading that is used with probability w."""
    x, P = one
    H, R = sensor
    K = P @ H / (H @ P @ H + R)
    A = np.eye(len(x)) - np.outer(K, H)
    updated, reduced = x + K * (z - H @ x), A @ P @ A.T + R * np.outer(K, K)
    return collapse(np.array([w, 1 - w]), np.array([updated, x]), np.array([reduced, P]))  # (7)


def normal(nu: Floats, S: Floats) -> Floats:
    """Return the normal density of nu with mean 0 and variance S."""
    density: Floats = np.exp(-0.5 * nu**2 / S) / np.sqrt(2 * np.pi * S)
    return density


def filter_readings(matrices: ModeMatrices, start: Floats, z: Floats, steps: Steps) -> list[Row]:
    """Filter z (N,); `steps` (N,) holds the index of the step before each row, -1 for none."""
    rows: list[Row] = []
    states: ModeStates | None = None
    for reading, step in zip(z, steps, strict=True):
        arrived = bool(np.abs(reading) <= _READABLE)
        if states is None:
            states = begin(reading, start) if arrived else None
            unknown = ModeStates(*(np.full_like(a, np.nan) for a in begin(0.0, start)))
            row = _without_update(unknown if states is None else states)
        else:
            if step >= 0:
                modes = modes_over(matrices, step)
                states = predict(mix(states, modes.T), modes)
            row = update(states, matrices, reading) if arrived else _without_update(states)
            states = row.posterior
        rows.append(row)
    return rows


def _without_update(states: ModeStates) -> Row:
    """Return a row without an update."""
    return Row(states, _no_information(states), 0.0, np.nan, np.nan, np.nan)


def _no_information(now: ModeStates) -> BackwardLikelihood:
    return BackwardLikelihood(now.x, np.zeros_like(now.x), np.zeros_like(now.P), np.zeros_like(now.mu))


def reading_likelihood(after: ModeStates, matrices: ModeMatrices, z: float, W: Floats) -> BackwardLikelihood:
    """Return the likelihood of a reading about the posterior mean; W (M,) is the probability of its use over R."""
    H = matrices.H[0]
    r = np.array([H * own * (z - H @ x) for own, x in zip(W, after.x, strict=True)])
    Y = np.array([np.outer(H, H) * own for own in W])
    return BackwardLikelihood(after.x, r, Y, np.zeros_like(W))  # (9)


def solve(A: Floats, B: Floats) -> tuple[Floats, Any]:
    """Return A^-1 B and log |A| by Gauss-Jordan elimination, in the precision of the input."""
    n, rows, logarithm = len(A), np.hstack([A, B]), A.dtype.type(0)
    for c in range(n):
        p = c + int(np.abs(rows[c:, c]).argmax())
        rows[[c, p]] = rows[[p, c]]
        logarithm += np.log(np.abs(rows[c, c]))
        rows[c] /= rows[c, c]
        others = np.arange(n) != c
        rows[others] -= np.outer(rows[others, c], rows[c])
    return rows[:, n:], logarithm


def evidence(x: Floats, P: Floats, ahead: BackwardLikelihood, i: int) -> Any:
    """Return the log-likelihood of the later readings, for a state with mean x and covariance P in mode i."""
    c, r, Y, g = (part[i] for part in ahead)
    d = x - c
    q = r - Y @ d  # the slope at x
    moved, determinant = solve(np.eye(len(x)) + P @ Y, (P @ q)[:, np.newaxis])
    return g + r @ d - d @ Y @ d / 2 + q @ moved[:, 0] / 2 - determinant / 2  # (12)


def before_step(F: Floats, Q: Floats, x: Floats, ahead: BackwardLikelihood, i: int) -> BackwardLikelihood:
    """Return the likelihood of the readings after a step into mode i, as a function of the state before the step.

    Its centre is x, and its arrays have no axis for modes.
    """
    c, r, Y, _ = (part[i] for part in ahead)
    A, _ = solve(np.eye(len(x)) + Y @ Q, np.eye(len(x)))
    own = evidence(F @ x, Q, ahead, i)  # log-likelihood for a step that starts exactly at x
    return BackwardLikelihood(x, F.T @ A @ (r - Y @ (F @ x - c)), F.T @ A @ Y @ F, np.array(own))  # (10), (11)


def smooth(matrices: ModeMatrices, rows: list[Row], steps: Steps) -> list[ModeStates]:
    """Smooth a filtered record: return the state of each row given all readings."""
    smoothed: list[ModeStates] = []
    ahead: BackwardLikelihood | None = None
    for k in range(len(rows) - 1, -1, -1):
        now, of_reading = rows[k].posterior, rows[k].likelihood
        if ahead is None or steps[k + 1] < 0 or np.isnan(now.mu[0]):
            own, pooled = now, _no_information(now)
        else:
            own, pooled = smooth_row(now, modes_over(matrices, steps[k + 1]), ahead)
        smoothed.append(own)
        r, Y, g = pooled.r + of_reading.r, pooled.Y + of_reading.Y, pooled.g + of_reading.g
        ahead = BackwardLikelihood(now.x, r, Y, g)  # (9)
    return smoothed[::-1]


def smooth_row(now: ModeStates, modes: Modes, ahead: BackwardLikelihood) -> tuple[ModeStates, BackwardLikelihood]:
    """Return the smoothed state of a row, and the likelihood of the later readings in each mode."""
    parts = [smooth_mode(now, modes, ahead, j) for j in range(len(now.mu))]
    fit = np.array([own for *_, own in parts]) + np.log(now.mu)
    mu = np.exp(fit - fit.max())
    x, P = (np.array(arrays) for arrays in list(zip(*parts, strict=True))[:2])
    pooled = BackwardLikelihood(
        *(np.array(arrays) for arrays in zip(*(of_reading for _, _, of_reading, _ in parts), strict=True))
    )
    return ModeStates(x, P, np.maximum(mu / mu.sum(), _UNLIKELY)), pooled


def smooth_mode(
    now: ModeStates, modes: Modes, ahead: BackwardLikelihood, j: int
) -> tuple[Floats, Floats, BackwardLikelihood, Any]:
    """Return mean and covariance of mode j, the likelihood of later readings as a function, and its log value."""
    x, P, n, count = now.x[j], now.P[j], now.x.shape[1], len(now.mu)
    likelihoods = [before_step(modes.F[i], modes.Q[i], x, ahead, i) for i in range(count)]
    every = BackwardLikelihood(*(np.array(arrays) for arrays in zip(*likelihoods, strict=True)))
    fit = np.array([evidence(x, P, every, i) for i in range(count)])
    fit += np.log(np.maximum(now.mu[j] * modes.T[j], _UNLIKELY**2)) - np.log(now.mu[j])
    weight = np.exp(fit - fit.max())
    log_likelihood, weight = np.log(weight.sum()) + fit.max(), weight / weight.sum()
    reduced = np.array([solve(np.eye(n) + P @ Y, P)[0] for Y in every.Y])
    mean, cov = collapse(weight, x + np.einsum("iab,ib->ia", reduced, every.r), reduced)  # (13)
    r, Y = weight @ every.r, np.einsum("i,iab->ab", weight, every.Y)
    pooled = BackwardLikelihood(x[np.newaxis], r[np.newaxis], Y[np.newaxis], np.zeros(1))
    g = np.array(log_likelihood - evidence(x, P, pooled, 0))
    return mean, cov, BackwardLikelihood(x, r, Y, g), log_likelihood  # (14)
