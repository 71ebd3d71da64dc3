"""Compute which unknowns of Q and R the autocovariances of readings determine, and estimate those roughly.

A stack of successive readings is y = O x + noise, with O the observability matrix. Its components orthogonal to O's
columns hold only noise, for any state, stationary or not. Their covariance is *linear* in the entries of Q and R. An
unknown that this linear map does not determine has no effect of its own on any second moment of the readings, and
Gaussian readings carry no other information. With 2 n + 1 rows the map covers all autocovariances of the readings after
the state is eliminated. Sources: Mehra, IEEE TAC-15 (1970) 175; Odelson, Rajamani and Rawlings, Automatica 42 (2006)
303.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Floats, Integers
from becalm.core.model.model import Model
from becalm.identification.several.matrices import Patterns

_RANK = 1e-9  # tolerance of the rank, for columns scaled to length one
_STRETCHES = 50_000  # most stacks of successive readings that an estimate uses


class Confounded(NamedTuple):
    """An unknown with the same effect on the readings as a mixture of other unknowns."""

    which: int  # index of the unknown
    others: Floats  # (k,) amounts of the other unknowns with the same effect as one unit of this one


@dataclass(frozen=True, eq=False)
class Autocovariances:
    """The linear map from the amounts of k patterns, those of Q before those of R, to second moments.

    Attributes
    ----------
    has_readings : (m,) bool array
        True for the h channels with at least one reading; the others are left out.
    units : (h,) float array
        Typical size of the readings of each channel, in its unit; readings are divided by it.
    rows : int
        Number of successive rows in a stack.
    noise_only : (rows * h, d) float array
        Orthonormal directions of stacked readings that do not depend on the state.
    slopes : (d * d, k) float array
        Derivatives of the covariance along these directions with respect to the amounts.
    fixed : (d * d,) float array
        Covariance along these directions due to the fixed part of Q and R.
    largest : (k,) float array
        Upper bounds of the lengths of the columns of `slopes`: their lengths if no terms cancelled.
    """

    has_readings: Booleans
    units: Floats
    rows: int
    noise_only: Floats
    slopes: Floats
    fixed: Floats
    largest: Floats

    @cached_property
    def lengths(self) -> Floats:
        """Return the lengths (k,) of the columns of `slopes`: how much one unit of each amount changes the moments."""
        return np.asarray(np.linalg.norm(self.slopes, axis=0))

    @cached_property
    def unseen(self) -> Booleans:
        """Return a mask (k,) of the unknowns on which no second moment of the readings depends."""
        return np.asarray(self.lengths <= _RANK * self.largest)

    @cached_property
    def rank(self) -> int:
        """Return the number of unknowns that the autocovariances determine."""
        diagonal = np.abs(np.diag(self._factors[0]))
        return int((diagonal > _RANK).sum())

    @cached_property
    def confounded(self) -> list[Confounded]:
        """Return the unknowns that affect the readings exactly as a mixture of others does."""
        from scipy.linalg import solve_triangular

        triangle, order = self._factors
        independent, dependent = order[: self.rank], order[self.rank :]
        mixtures = solve_triangular(triangle[: self.rank, : self.rank], triangle[: self.rank, self.rank :])
        mixtures[np.abs(mixtures) < np.sqrt(_RANK)] = 0.0
        confounded = []
        for which, mixture in zip(dependent, mixtures.T, strict=True):
            if not self.unseen[which]:
                others = np.zeros(len(order))
                others[independent] = mixture * self.lengths[which] / self.lengths[independent]
                confounded.append(Confounded(int(which), others))
        return confounded

    def undetermined_amounts(self) -> Floats:
        """Return the directions of amounts (k, number of directions) along which no moment changes."""
        directions = [-np.eye(len(self.lengths))[which] for which in np.flatnonzero(self.unseen)]
        for which, others in self.confounded:
            directions.append(others - np.eye(len(others))[which])
        return np.array(directions).reshape(-1, len(self.lengths)).T

    def estimate(self, z: Floats) -> Floats | None:
        """Estimate the amounts (k,) by least squares on the moments of readings z (N, m).

        Return None if there are too few complete stacks of readings.

        Notes
        -----
        The fit is unweighted. It cannot resolve process noise whose effect over `rows` rows is small compared with the
        readings' noise; use it only as a starting point. Amounts may be negative.
        """
        if len(z) < self.rows:
            return None
        stretches = np.lib.stride_tricks.sliding_window_view(z[:, self.has_readings] / self.units, self.rows, axis=0)
        stretches = np.swapaxes(stretches[:: 1 + len(stretches) // _STRETCHES], 1, 2)
        noise = stretches.reshape(len(stretches), -1) @ self.noise_only
        noise = noise[np.isfinite(noise).all(axis=1)]
        if len(noise) < 2 * self.noise_only.shape[1]:
            return None
        moments = (noise.T @ noise / len(noise)).ravel() - self.fixed
        seen = ~self.unseen
        amounts = np.zeros(len(seen))
        scaled = self.slopes[:, seen] / self.lengths[seen]
        amounts[seen] = np.linalg.lstsq(scaled, moments, rcond=_RANK)[0] / self.lengths[seen]
        return amounts

    @cached_property
    def _factors(self) -> tuple[Floats, Integers]:
        """Return the triangle of the scaled map and the order of its columns, the most independent first."""
        from scipy.linalg import qr

        lengths = np.where(self.unseen, np.inf, self.lengths)
        triangle, order = qr(self.slopes / lengths, mode="r", pivoting=True)
        k = len(order)
        return np.vstack([triangle, np.zeros((k, k))])[:k], np.asarray(order, dtype=np.int64)


def autocovariances(
    model: Model, process: Patterns, noise: Patterns, together: Booleans, sizes: Floats
) -> Autocovariances:
    """Return the linear map from the free entries of Q and R to the second moments of readings.

    Parameters
    ----------
    model : Model
        A model with n states and m channels, of which F, G and H are used.
    process, noise : Patterns
        Patterns of the free entries of Q and of R.
    together : (m, m) bool array
        True for pairs of channels with readings in the same row at least once; on the diagonal, for channels with
        readings.
    sizes : (m,) float array
        Typical size of the readings of each channel, in its unit; it makes channels of different units comparable.
    """
    has_readings = np.diag(together)
    units, R = sizes[has_readings], model.R[np.ix_(has_readings, has_readings)]
    observed_model = Model(F=model.F, H=model.H[has_readings] / units[:, np.newaxis], Q=model.Q, R=R, G=model.G)
    H, rows = observed_model.H, 2 * model.states + 1
    observability = np.vstack([H @ power for power in _powers(model.F, rows)])
    vectors, _, _ = np.linalg.svd(observability)
    noise_only = vectors[:, model.states - observed_model.unobservable.shape[1] :]
    shapes = [
        (R * together)[np.ix_(has_readings, has_readings)] / np.outer(units, units)
        for R in (*noise.shapes, noise.fixed)
    ]
    parts = (H, model.F, model.G, noise_only)
    moments = _moments(parts, [*process.shapes, process.fixed], shapes)
    bounds = _moments([np.abs(part) for part in parts], np.abs(process.shapes), np.abs(shapes[:-1]))
    k = len(process.shapes)
    slopes, fixed = np.delete(moments, [k, -1], axis=1), moments[:, k] + moments[:, -1]
    return Autocovariances(has_readings, units, rows, noise_only, slopes, fixed, np.linalg.norm(bounds, axis=0))


def _moments(parts: Sequence[Floats], process: Iterable[Floats], noise: Iterable[Floats]) -> Floats:
    """Return the second moments, one column for each covariance of process noise and then of measurement noise."""
    H, F, G, noise_only = parts
    rows = len(noise_only) // len(H)
    effects = [_noise_effect(H, G, _powers(F, rows), row).T @ noise_only for row in range(1, rows)]
    stacked = noise_only.reshape(rows, len(H), -1)
    columns = [np.sum([E.T @ Q @ E for E in effects], axis=0).ravel() for Q in process]
    columns += [np.einsum("kai,ab,kbj->ij", stacked, R, stacked, optimize=True).ravel() for R in noise]
    return np.array(columns).T


def _powers(F: Floats, count: int) -> list[Floats]:
    """Return the first `count` powers of F, from the identity on."""
    powers = [np.eye(len(F))]
    for _ in range(count - 1):
        powers.append(powers[-1] @ F)
    return powers


def _noise_effect(H: Floats, G: Floats, powers: list[Floats], row: int) -> Floats:
    """Return the effect (rows * m, p) on all stacked rows of the process noise in the step before `row`."""
    before = np.zeros((row * len(H), G.shape[1]))
    return np.vstack([before, *(H @ power @ G for power in powers[: len(powers) - row])])
