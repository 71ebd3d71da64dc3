"""Information before a state is known: what the next state says of this one, against exact fractions."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.components import motion
from becalm.core.model import Model
from becalm.core.starting import Information, regress

Exact = list[list[Fraction]]


def exact(matrix: Floats) -> Exact:
    return [[Fraction(float(value)) for value in row] for row in matrix]


def product(first: Exact, second: Exact) -> Exact:
    return [
        [sum(a * b for a, b in zip(row, column, strict=True)) for column in zip(*second, strict=True)] for row in first
    ]


def inverse(matrix: Exact) -> Exact:
    size = len(matrix)
    wide = [[*row, *(Fraction(int(i == j)) for j in range(size))] for i, row in enumerate(matrix)]
    for i in range(size):
        pivot = max(range(i, size), key=lambda k: abs(wide[k][i]))
        wide[i], wide[pivot] = wide[pivot], wide[i]
        wide[i] = [value / wide[i][i] for value in wide[i]]
        for k in set(range(size)) - {i}:
            wide[k] = [a - wide[k][i] * b for a, b in zip(wide[k], wide[i], strict=True)]
    return [row[size:] for row in wide]


def gap_after_readings(order: int, gap_s: float) -> tuple[Information, Model]:
    """Information of as many readings as there are states, one a second, and a step after them."""
    ways = motion(order, noise_density=3307.8)
    back = np.linalg.inv(ways.to_model(step_s=1.0, noise_variance=1.0).F)
    rows = np.array([np.linalg.matrix_power(back, ago)[0] for ago in range(order)])
    return Information(rows.T @ rows, rows.T @ np.arange(order)), ways.to_model(step_s=gap_s, noise_variance=1.0)


@pytest.mark.parametrize("gap_s", [1e-3, 1.0, 1156.0, 1e5])
@pytest.mark.parametrize("order", range(1, 6))
def test_a_state_given_the_next_is_told_however_long_the_gap(order: int, gap_s: float) -> None:
    now, model = gap_after_readings(order, gap_s)
    found = regress(now, model.F, model.process_covariance)
    F, Y, y = exact(model.F), exact(now.Y), exact(now.y[:, np.newaxis])
    pull = product([list(row) for row in zip(*F, strict=True)], inverse(exact(model.process_covariance)))
    told = product(pull, F)
    W = inverse([[a + b for a, b in zip(*rows, strict=True)] for rows in zip(Y, told, strict=True)])
    std = np.sqrt(np.diag(np.array(W, float)))
    np.testing.assert_allclose(found.W / np.outer(std, std), np.array(W, float) / np.outer(std, std), atol=1e-8)
    J, c = (np.array(product(W, matrix), float) for matrix in (pull, y))
    np.testing.assert_allclose(found.J * std / std[:, np.newaxis], J * std / std[:, np.newaxis], atol=1e-8)
    np.testing.assert_allclose(found.c / std, c[:, 0] / std, atol=1e-8)


def test_a_part_without_noise_needs_no_inverse() -> None:
    now, model = gap_after_readings(2, 1.0)
    still = np.diag([1.0, 0.0])
    found = regress(now, model.F, still)
    nearly = regress(now, model.F, np.diag([1.0, 1e-9]))
    np.testing.assert_allclose(found.W, nearly.W, atol=1e-6)
    np.testing.assert_allclose(found.J, nearly.J, atol=1e-6)
    np.testing.assert_allclose(found.c, nearly.c, atol=1e-6)
