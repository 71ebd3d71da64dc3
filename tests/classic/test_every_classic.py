"""What every classic filter keeps: no hidden zero, no unit of its own, and what its kind says of polynomials."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import savgol_filter

from becalm.classic.register import CLASSICS, Classic
from becalm.classic.zero_phase import savitzky_golay, whittaker

RNG = np.random.default_rng(4)
Z = np.round((np.cumsum(0.1 * RNG.normal(size=1500)) + RNG.normal(size=1500)) * 2**20) / 2**20  # exact beside 2**30
EVERY = pytest.mark.parametrize("classic", CLASSICS.values(), ids=CLASSICS)


@EVERY
@pytest.mark.parametrize("cutoff", [0.1, 0.01, 0.002])
def test_a_large_offset_changes_nothing(classic: Classic, cutoff: float) -> None:
    np.testing.assert_allclose(classic.clean(Z + 2**30, cutoff) - 2**30, classic.clean(Z, cutoff), atol=1e-6)


@EVERY
def test_another_unit_changes_nothing(classic: Classic) -> None:
    np.testing.assert_allclose(classic.clean(1e6 * Z, 0.02), 1e6 * classic.clean(Z, 0.02), rtol=1e-9, atol=1e-3)


@EVERY
@pytest.mark.parametrize("count", [1, 2, 3, 5, 8])
def test_the_shortest_records_are_filtered(classic: Classic, count: int) -> None:
    for cutoff in (0.49, 0.1, 1e-4):
        out = classic.clean(Z[:count], cutoff)
        assert out.shape == (count,)
        assert np.isfinite(out).all()


@pytest.mark.parametrize("degree", [2, 3, 4, 5])
@pytest.mark.parametrize("length", [11, 1001, 9001])
def test_savitzky_and_golay_keep_polynomials_of_their_degree(degree: int, length: int) -> None:
    place = np.linspace(-1, 1, 10_000)
    z = 1e3 + place**degree
    np.testing.assert_allclose(savitzky_golay(z, length, degree), z, atol=1e-10)


def test_savitzky_and_golay_fit_as_the_library_does_where_its_powers_hold() -> None:
    for degree, length in ((2, 101), (3, 31), (5, 21)):
        np.testing.assert_allclose(savitzky_golay(Z, length, degree), savgol_filter(Z, length, degree), atol=1e-9)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_whittaker_solves_its_least_squares_and_keeps_polynomials(order: int) -> None:
    z, cutoff = Z[:300], 0.02
    D = np.diff(np.eye(300), order, axis=0)
    weight = (2 * np.sin(np.pi * cutoff)) ** (-2 * order)
    np.testing.assert_allclose(
        whittaker(z, cutoff, order), np.linalg.solve(np.eye(300) + weight * D.T @ D, z), atol=1e-8
    )
    kept = 1e6 + np.arange(5000.0) ** (order - 1)
    np.testing.assert_allclose(whittaker(kept, 1e-3, order), kept, rtol=1e-9)
