"""One channel's filter and smoother in a hundred digits: the road beside those of the code."""

from __future__ import annotations

from decimal import Decimal
from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.core.model.components import Component


class Exact(NamedTuple):
    """One row in a hundred digits."""

    F: Any  # of the step before it
    x: Any
    P: Any
    K: Any  # 0 where no reading came
    S: Decimal
    nu: Decimal


def exact_rows(component: Component, R: float, z: Floats, elapsed: Floats) -> list[Exact]:
    """Return the rows of a record by the recursion in a hundred digits, from a prior that is as good as none."""
    model, wide = component.to_model(1.0, R), Decimal(10) ** 40
    x, P, H = decimals(np.zeros(model.states)), decimals(np.eye(model.states)) * wide, decimals(model.H[0])
    if model.known is not None:
        left = decimals(model.known)  # = sum of d l l': what the model knows is a reading of 0 of variance 1/d
        for k in range(model.states):
            if left[k, k] > 0:
                weight, row = left[k, k], left[k] / left[k, k]
                left = left - weight * np.outer(row, row)
                x, P = learnt(x, P, row, Decimal(0), 1 / weight)
    rows: list[Exact] = []
    steps: dict[float, tuple[Any, Any]] = {}
    for k, reading in enumerate(z):
        F = decimals(np.eye(model.states))
        if k:
            if elapsed[k] not in steps:
                (F,), (Q,) = component.over(elapsed[k : k + 1])
                steps[elapsed[k]] = decimals(F), decimals(Q)
            F, Q = steps[elapsed[k]]
            x, P = F @ x, F @ P @ F.T + Q
        K, S, nu = decimals(np.zeros(model.states)), Decimal(1), Decimal(0)
        if np.isfinite(reading):
            nu, S = Decimal(float(reading)) - H @ x, H @ P @ H + Decimal(R)
            K = P @ H / S
            x, P = learnt(x, P, H, Decimal(float(reading)), Decimal(R))
        rows.append(Exact(F, x, P, K, S, nu))
    return rows


def exact(component: Component, R: float, z: Floats, elapsed: Floats) -> tuple[Floats, ...]:
    """Return signal, sigma, innovations and their deviations, in a hundred digits."""
    rows, C = exact_rows(component, R, z, elapsed), decimals(component.signal_output[0])
    signal = np.array([float(C @ row.x) for row in rows])
    sigma = np.array([float((C @ row.P @ C).sqrt()) for row in rows])
    innovation = np.where(np.isfinite(z), [float(row.nu) for row in rows], np.nan)
    return signal, sigma, innovation, np.where(np.isfinite(z), [float(row.S.sqrt()) for row in rows], np.nan)


def exact_smoothed(component: Component, R: float, z: Floats, elapsed: Floats) -> tuple[Floats, Floats]:
    """Return signal and sigma of a smoother, equations (9) to (12) of the specification, in a hundred digits."""
    rows, C = exact_rows(component, R, z, elapsed), decimals(component.signal_output[0])
    H, n = decimals(component.to_model(1.0, R).H[0]), len(C)
    r, N = decimals(np.zeros(n)), decimals(np.zeros((n, n)))
    signal, sigma = np.empty(len(z)), np.empty(len(z))
    for k in range(len(z) - 1, -1, -1):
        row = rows[k]
        P = row.P - row.P @ N @ row.P
        signal[k], sigma[k] = float(C @ (row.x + row.P @ r)), float((C @ P @ C).sqrt())
        A = decimals(np.eye(n)) - np.outer(row.K, H)
        seen = Decimal(int(np.isfinite(z[k])))
        r = row.F.T @ (H * (seen * row.nu / row.S) + A.T @ r)
        N = row.F.T @ (np.outer(H, H) * (seen / row.S) + A.T @ N @ A) @ row.F
    return signal, sigma


def learnt(x: Any, P: Any, h: Any, reading: Decimal, variance: Decimal) -> tuple[Any, Any]:
    K = P @ h / (h @ P @ h + variance)
    return x + K * (reading - h @ x), P - np.outer(K, h @ P)


def decimals(values: Floats) -> Any:
    return np.vectorize(Decimal, otypes=[object])(values)
