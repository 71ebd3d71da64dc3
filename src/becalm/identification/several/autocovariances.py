"""What the readings' autocovariances tell of Q and R: which unknowns, how many, and roughly how much.

Some successive readings stacked are y = O x + noise, with O the observability matrix. On what is
orthogonal to O's columns only noise is left, whatever the state and whether or not it grows, and its
covariance is *linear* in the entries of Q and R. What that linear map does not tell, no second moment
of the readings tells, and for Gaussian noise there is nothing else. Over 2 n + 1 rows it holds all
autocovariances of the annihilated readings. Sources: Mehra, IEEE TAC-15 (1970) 175; Odelson, Rajamani
and Rawlings, Automatica 42 (2006) 303.
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

_RANK = 1e-9  # of columns scaled to length one
_STRETCHES = 50_000


class Confounded(NamedTuple):
    """An unknown that looks like a mixture of others."""

    which: int
    others: Floats  # (k,) how much of each of the others one unit of it looks like


@dataclass(frozen=True, eq=False)
class Autocovariances:
    """The linear map from amounts of k patterns, first those of Q and then those of R, to second moments.

    Attributes
    ----------
    heard : (m,) bool array
        Channels of which any reading arrived; the others are left out.
    units : (heard,) float array
        Of each channel, in which its readings have about size one.
    rows : int
        Successive readings that are looked at together.
    noise_only : (rows * heard, d) float array
        Orthonormal directions of stacked readings that see no state.
    slopes : (d * d, k) float array
        Their covariance, by amounts.
    held : (d * d,) float array
        Their covariance from what is not free.
    largest : (k,) float array
        Lengths that the columns of `slopes` would have if nothing in them cancelled.
    """

    heard: Booleans
    units: Floats
    rows: int
    noise_only: Floats
    slopes: Floats
    held: Floats
    largest: Floats

    @cached_property
    def lengths(self) -> Floats:
        """How much one unit of each amount moves the moments, (k,)."""
        return np.asarray(np.linalg.norm(self.slopes, axis=0))

    @cached_property
    def unseen(self) -> Booleans:
        """Unknowns on which no second moment of the readings depends, (k,)."""
        return np.asarray(self.lengths <= _RANK * self.largest)

    @cached_property
    def rank(self) -> int:
        """How many unknowns the autocovariances tell."""
        diagonal = np.abs(np.diag(self._factors[0]))
        return int((diagonal > _RANK).sum())

    @cached_property
    def confounded(self) -> list[Confounded]:
        """Unknowns that are seen, but look like mixtures of others."""
        from scipy.linalg import solve_triangular

        triangle, order = self._factors
        first, rest = order[: self.rank], order[self.rank :]
        mixtures = solve_triangular(triangle[: self.rank, : self.rank], triangle[: self.rank, self.rank :])
        mixtures[np.abs(mixtures) < np.sqrt(_RANK)] = 0.0
        found = []
        for which, mixture in zip(rest, mixtures.T, strict=True):
            if not self.unseen[which]:
                others = np.zeros(len(order))
                others[first] = mixture * self.lengths[which] / self.lengths[first]
                found.append(Confounded(int(which), others))
        return found

    def untold(self) -> Floats:
        """Return directions of amounts along which nothing changes, (k, untold)."""
        directions = [-np.eye(len(self.lengths))[which] for which in np.flatnonzero(self.unseen)]
        for which, others in self.confounded:
            directions.append(others - np.eye(len(others))[which])
        return np.array(directions).reshape(-1, len(self.lengths)).T

    def estimate(self, z: Floats) -> Floats | None:
        """Return amounts (k,) by least squares on the moments of readings z (N, m); None where too few follow.

        Notes
        -----
        Unweighted, and blind to process noise that is small against the readings' noise over `rows`
        readings; no more than a place to start from. Amounts may come out negative.
        """
        if len(z) < self.rows:
            return None
        stretches = np.lib.stride_tricks.sliding_window_view(z[:, self.heard] / self.units, self.rows, axis=0)
        stretches = np.swapaxes(stretches[:: 1 + len(stretches) // _STRETCHES], 1, 2)
        noise = stretches.reshape(len(stretches), -1) @ self.noise_only
        noise = noise[np.isfinite(noise).all(axis=1)]
        if len(noise) < 2 * self.noise_only.shape[1]:
            return None
        moments = (noise.T @ noise / len(noise)).ravel() - self.held
        seen = ~self.unseen
        amounts = np.zeros(len(seen))
        scaled = self.slopes[:, seen] / self.lengths[seen]
        amounts[seen] = np.linalg.lstsq(scaled, moments, rcond=_RANK)[0] / self.lengths[seen]
        return amounts

    @cached_property
    def _factors(self) -> tuple[Floats, Integers]:
        """Return the triangle of the scaled map and the order of its columns, the plainest first."""
        from scipy.linalg import qr

        lengths = np.where(self.unseen, np.inf, self.lengths)
        triangle, order = qr(self.slopes / lengths, mode="r", pivoting=True)
        k = len(order)
        return np.vstack([triangle, np.zeros((k, k))])[:k], np.asarray(order, dtype=np.int64)


def autocovariances(
    model: Model, process: Patterns, noise: Patterns, together: Booleans, sizes: Floats
) -> Autocovariances:
    """Return what second moments of readings tell of Q and R.

    Parameters
    ----------
    model : Model
        Its F, G and H; n states, m channels.
    process, noise : Patterns
        What is free of Q and of R.
    together : (m, m) bool array
        Pairs of channels of which readings ever arrived in the same row; on its diagonal, those that ever did.
    sizes : (m,) float array
        About how large the readings of each channel are, in its unit, so that channels of any units compare.
    """
    heard = np.diag(together)
    units, R = sizes[heard], model.R[np.ix_(heard, heard)]
    heard_model = Model(F=model.F, H=model.H[heard] / units[:, np.newaxis], Q=model.Q, R=R, G=model.G)
    H, rows = heard_model.H, 2 * model.states + 1
    sees = np.vstack([H @ power for power in _powers(model.F, rows)])
    vectors, _, _ = np.linalg.svd(sees)
    noise_only = vectors[:, model.states - heard_model.unobservable.shape[1] :]
    shapes = [(R * together)[np.ix_(heard, heard)] / np.outer(units, units) for R in (*noise.shapes, noise.held)]
    parts = (H, model.F, model.G, noise_only)
    moments = _moments(parts, [*process.shapes, process.held], shapes)
    bounds = _moments([np.abs(part) for part in parts], np.abs(process.shapes), np.abs(shapes[:-1]))
    k = len(process.shapes)
    slopes, held = np.delete(moments, [k, -1], axis=1), moments[:, k] + moments[:, -1]
    return Autocovariances(heard, units, rows, noise_only, slopes, held, np.linalg.norm(bounds, axis=0))


def _moments(parts: Sequence[Floats], process: Iterable[Floats], noise: Iterable[Floats]) -> Floats:
    """Return the second moments, one column each, that process covariances and those of readings bring about."""
    H, F, G, noise_only = parts
    rows = len(noise_only) // len(H)
    enters = [_enter(H, G, _powers(F, rows), late).T @ noise_only for late in range(1, rows)]
    stacked = noise_only.reshape(rows, len(H), -1)
    columns = [np.sum([E.T @ Q @ E for E in enters], axis=0).ravel() for Q in process]
    columns += [np.einsum("kai,ab,kbj->ij", stacked, R, stacked, optimize=True).ravel() for R in noise]
    return np.array(columns).T


def _powers(F: Floats, count: int) -> list[Floats]:
    """Return the first powers of F, from the identity on."""
    powers = [np.eye(len(F))]
    for _ in range(count - 1):
        powers.append(powers[-1] @ F)
    return powers


def _enter(H: Floats, G: Floats, powers: list[Floats], late: int) -> Floats:
    """Return how the noise of the step before row `late` enters all rows stacked, (rows * m, p)."""
    before = np.zeros((late * len(H), G.shape[1]))
    return np.vstack([before, *(H @ power @ G for power in powers[: len(powers) - late])])
