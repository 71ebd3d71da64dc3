"""Define the free entries of Q and R, and map them to parameters without bounds.

A covariance is a sum of *patterns*, each times an amount. This form is linear, and shows which amounts readings can
determine. For the search, the covariance is written so that any parameters give a valid matrix. If every entry is free,
the covariance is C0 L L' C0' with the root C0 of the starting covariance and a triangular L; the parameters are the
entries of L, but the logarithms of those on the diagonal (Pinheiro and Bates, Statistics and Computing 6 (1996) 289).
Otherwise each starting amount is multiplied by exp(2 t), with its parameter t.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from becalm.core.arrays import Booleans, Floats, Integers
from becalm.errors import ModelError

Freedom = Literal["full", "diagonal", "scale", "fixed"]
"""Which entries of a covariance are free.

"full": every entry. "diagonal": the variances, with all other entries zero. "scale": one factor for each independent
block, such as components joined by `+`. "fixed": none.
"""

FURTHEST = 20.0
"""Largest distance of the logarithm of a standard deviation from its start."""


@dataclass(frozen=True, eq=False)
class Patterns:
    """A covariance (d, d) as the sum of k patterns, each with an amount, and a fixed part.

    Attributes
    ----------
    names : tuple of k str
        Names for messages, such as "Q[0,1]".
    shapes : (k, d, d) float array
        The patterns; no two of them share an entry.
    fixed : (d, d) float array
        The fixed part, in unit^2.
    """

    names: tuple[str, ...]
    shapes: Floats
    fixed: Floats

    @property
    def variances(self) -> Booleans:
        """Return a mask (k,) of the patterns that hold variances; the others hold covariances."""
        return np.asarray(np.trace(self.shapes, axis1=1, axis2=2) > 0)

    def amounts(self, covariance: Floats) -> Floats:
        """Return the amount (k,) of each pattern in a covariance (d, d)."""
        inside = np.einsum("kij,ij->k", self.shapes, covariance)
        return np.asarray(inside / np.einsum("kij,kij->k", self.shapes, self.shapes))

    def scales(self, covariance: Floats) -> Floats:
        """Return the scale (k,) of each amount: its value if all entries of its pattern were fully correlated."""
        sigma, sizes = np.sqrt(np.diag(covariance)), np.abs(self.shapes)
        return np.asarray(np.einsum("kij,i,j->k", sizes, sigma, sigma) / np.einsum("kij,kij->k", sizes, sizes))

    def covariance(self, amounts: Floats) -> Floats:
        """Return the covariance (d, d) for any amounts (k,); it may have negative eigenvalues."""
        return np.asarray(self.fixed + np.einsum("k,kij->ij", amounts, self.shapes))


def patterns_of(letter: str, covariance: Floats, freedom: Freedom) -> Patterns:
    """Return the patterns of the free entries of a covariance (d, d), whose name is `letter`.

    Raises
    ------
    ModelError
        If `freedom` is not one of the four.
    """
    d, nothing = len(covariance), np.zeros_like(covariance)
    if freedom == "fixed":
        return Patterns((), np.zeros((0, d, d)), covariance)
    if freedom == "scale":
        blocks = _blocks(covariance)
        masks = [np.isin(np.arange(d), block) for block in blocks]
        shapes = [covariance * np.outer(mask, mask) for mask in masks]
        names = tuple(f"the scale of {letter}[{_row_names(block)}]" for block in blocks)
        return Patterns(names, np.array(shapes).reshape(-1, d, d), nothing)
    if freedom not in ("diagonal", "full"):
        raise ModelError(
            f"{freedom!r} is not a choice of free entries of {letter}; use one of {list(get_args(Freedom))}."
        )
    pairs = [(i, j) for i in range(d) for j in range(i + 1) if i == j or freedom == "full"]
    shapes = [_unit(d, i, j) for i, j in pairs]
    return Patterns(tuple(f"{letter}[{j},{i}]" for i, j in pairs), np.array(shapes), nothing)


@dataclass(frozen=True, eq=False)
class FreeMatrix:
    """A covariance as a function of k parameters without bounds, which are 0 at its start.

    Attributes
    ----------
    patterns : Patterns
        The free entries.
    start : (d, d) float array
        The starting covariance; positive definite if every entry is free.
    fully : bool
        True if every entry is free.
    """

    patterns: Patterns
    start: Floats
    fully: bool

    @property
    def count(self) -> int:
        """Return the number of parameters, k."""
        return len(self.patterns.names)

    def at(self, theta: Floats) -> Floats:
        """Return the covariance (d, d) at theta (k,)."""
        if self.fully:
            root = self._root @ self._triangle(theta)
            return np.asarray(root @ root.T)
        scaled = self._start_amounts * _bounded_exp(theta) ** 2
        return self.patterns.covariance(scaled)

    def slopes(self, theta: Floats) -> Floats:
        """Return the derivatives (k, d, d) of the covariance with respect to the parameters."""
        if not self.fully:
            scaled = self._start_amounts * _bounded_exp(theta) ** 2
            return np.asarray(2 * scaled[:, np.newaxis, np.newaxis] * self.patterns.shapes)
        rows, columns = self._places
        C, L = self._root, self._triangle(theta)
        moved = np.zeros((self.count, len(C), len(C)))
        moved[np.arange(self.count), rows, columns] = np.where(self._on_diagonal, L[rows, columns], 1.0)
        half = C @ moved @ L.T @ C.T
        return np.asarray(half + np.swapaxes(half, 1, 2))

    @cached_property
    def _root(self) -> Floats:
        return np.asarray(np.linalg.cholesky(self.start))

    @cached_property
    def _places(self) -> tuple[Integers, Integers]:
        return np.tril_indices(len(self.start))

    @cached_property
    def _on_diagonal(self) -> Booleans:
        return np.equal(*self._places)

    @cached_property
    def _start_amounts(self) -> Floats:
        return self.patterns.amounts(self.start)

    def _triangle(self, theta: Floats) -> Floats:
        L = np.zeros(self.start.shape)
        L[self._places] = np.where(self._on_diagonal, _bounded_exp(theta), theta)
        return L


def _bounded_exp(theta: Floats) -> Floats:
    return np.asarray(np.exp(np.minimum(np.maximum(theta, -FURTHEST), FURTHEST)))


def _unit(d: int, i: int, j: int) -> Floats:
    """Return the symmetric (d, d) matrix whose entries i, j and j, i are one."""
    unit = np.zeros((d, d))
    unit[i, j] = unit[j, i] = 1.0
    return unit


def _blocks(covariance: Floats) -> list[Integers]:
    """Return the rows of each independent block; rows that are all zero form no block."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    number, labels = connected_components(csr_array(covariance != 0), directed=False)
    blocks = [np.flatnonzero(labels == label) for label in range(number)]
    return [block for block in blocks if covariance[block[0]].any()]


def _row_names(block: Integers) -> str:
    """Return a name of rows: 0 or 0:3, or a list where they are not consecutive."""
    first, last = int(block[0]), int(block[-1])
    if last - first + 1 != len(block):
        return ",".join(str(int(row)) for row in block)
    return str(first) if first == last else f"{first}:{last + 1}"
