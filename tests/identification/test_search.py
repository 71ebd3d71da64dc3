"""The one search: it finds the deepest of several valleys, either way along its grid, and says where it ended."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.closed_forms import cutoff_to_ratio
from becalm.identification.likelihood import find_least, find_ratio, log_cutoffs

GRID = np.linspace(-4.0, 4.0, 17)


def two_valleys(x: float) -> float:
    """The deeper one lies at 2.2, as far as its neighbour at -1.7 lets it."""
    return float(-np.exp(-((x + 1.7) ** 2)) - 2 * np.exp(-((x - 2.2) ** 2)))


@pytest.mark.parametrize("grid", [GRID, GRID[::-1]])
def test_the_deeper_of_two_valleys_is_found(grid: Floats) -> None:
    found = find_least(two_valleys, grid, 1e-6)
    fine = np.linspace(-4, 4, 800_001)
    assert found.at == pytest.approx(fine[np.argmin([two_valleys(x) for x in fine.tolist()])], abs=2e-5)
    assert found.cost == pytest.approx(two_valleys(found.at), rel=1e-12)
    assert found.at_edge == ""


@pytest.mark.parametrize("grid", [GRID, GRID[::-1]])
@pytest.mark.parametrize(
    ("bottom", "edge"), [(-9.0, "low"), (-3.99, "low"), (-3.9, ""), (0.3, ""), (3.9, ""), (3.99, "high"), (9.0, "high")]
)
def test_an_edge_is_where_the_grid_ends(grid: Floats, bottom: float, edge: str) -> None:
    """Within a twentieth of the distance of two points, 0.025 here; beside the last point is not at the edge."""
    assert find_least(lambda x: (x - bottom) ** 2, grid, 1e-4).at_edge == edge


def test_a_search_stops_once_it_is_told_that_it_is_enough() -> None:
    tried: list[float] = []

    def cost(x: float) -> float:
        tried.append(x)
        return x**2

    def risen(costs: Sequence[float]) -> bool:
        return costs[-1] > min(costs) + 1

    found = find_least(cost, GRID, 1e-6, risen)
    assert tried[:12] == GRID[:12].tolist()  # from -4 over 0 to 1.5; only Brent's method comes after
    assert max(map(abs, tried[12:])) < 0.5
    assert found.at == pytest.approx(0, abs=1e-5)
    assert found.evaluations == len(tried)


def test_what_is_nowhere_finite_has_no_least() -> None:
    found = find_least(lambda x: np.inf, GRID, 1e-6)
    assert found.cost == np.inf
    assert found.evaluations == len(GRID)


@pytest.mark.parametrize("order", [1, 3, 5])
@pytest.mark.parametrize("near", [None, 1e-3, 1e3])
def test_a_ratio_is_found_by_its_cut_off(order: int, near: float | None) -> None:
    """From anywhere, and from beside a hint, right or wrong."""
    tried: list[float] = []

    def cost(ratio: float) -> float:
        tried.append(ratio)
        return float((np.log(ratio) / (2 * order) - np.log(0.1)) ** 2)

    hint = None if near is None else cutoff_to_ratio(order, 0.1) * near
    found = find_ratio(order, cost, 1000.0, near=hint)
    assert np.log(found.ratio) / (2 * order) == pytest.approx(np.log(0.1), abs=3e-3)
    assert found.cost == pytest.approx(cost(found.ratio), abs=1e-15)
    assert found.at_edge == ""
    calls = len(tried)
    find_ratio(order, cost, 1000.0, near=cutoff_to_ratio(order, 0.1))
    assert len(tried) - calls < 15 < calls  # beside the right hint three points do for the grid


def test_cut_offs_go_from_all_to_a_fifth_of_a_cycle() -> None:
    cutoffs = np.exp(log_cutoffs(1000.0, 5))
    assert (cutoffs[0], cutoffs[-1]) == pytest.approx((4.0, 2 * np.pi * 0.2 / 1000))
    np.testing.assert_allclose(cutoffs[1:] / cutoffs[:-1], cutoffs[1] / cutoffs[0])
