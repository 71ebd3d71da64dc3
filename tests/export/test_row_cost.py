"""What a row costs is counted in its C: each operation as often as its loops run."""

from __future__ import annotations

import pytest

from becalm.export.row_cost import row_cost
from exported import bundle, channel


def test_what_a_row_costs_is_counted_by_its_loops() -> None:
    source = """static double b_one(double x)
{
    return x * x + 1.0;
}

static double b_all(double x)
{
    double sum = 0.0;
    for (uint32_t a = 0u; a < 3u; a++) {
        sum += b_one(x) / x;
        for (uint32_t b = 0u; b <= a; b++) {
            sum += x * x;
        }
        for (uint32_t b = 0u; b < a; b++) {
            sum -= x;
        }
    }
    return sum;
}
"""
    assert row_cost(source, ["b_all", "b_none"]) == (3 + 6, 3 + 3 + 6 + 3, 3)
    assert row_cost(source, ["b_all"], never=["b_one"]) == (6, 3 + 6 + 3, 3)


GIVEN = """static void b_move(const double *F, size_t columns)
{
    for (size_t back = 0u; back < 3u; back++) {
        const size_t j = 3u - back;
        for (size_t k = 0u; told && (k < columns); k++) {
            W[j][k] -= F[(j * 3u) + k] * 0x1.8p+1;
        }
    }
    s->row = row + 1u;
    b_next(s, 3u + columns);
    x = (x < -0x1.0p+9) ? -0x1.0p+9 : x;
}
"""


def test_a_loop_up_to_what_is_given_runs_as_often_as_is_said() -> None:
    assert row_cost(GIVEN, ["b_move"], turns={"b_move": 4}) == (12, 12, 0)
    with pytest.raises(ValueError, match="up to columns"):
        row_cost(GIVEN, ["b_move"])


@pytest.mark.parametrize(("gain", "cost"), [("settled", (3, 7, 0)), ("full", (4 + 2 + 2 + 2, 4 + 3 + 2 + 3, 0))])
def test_a_settled_slope_costs_what_its_equations_have(gain: str, cost: tuple[int, int, int]) -> None:
    """Three gains, of F K and of C K; or a whole F, and two each for the innovation, the gain and the signal."""
    (one,) = bundle(channel("ax", 2, 0.05), gain=gain, precision="float64").channels
    assert one.written.cost == cost


def test_a_whole_slope_costs_what_its_loops_do() -> None:
    """A slope that never settles, counted by hand: no noise drives it, so that W has two columns."""
    (one,) = bundle(channel("ax", 2, 0.0), gain="full", precision="float64").channels
    predicted, innovation, corrected, signal = (4, 4, 0), (2, 3, 0), (2, 2, 0), (2, 3, 0)
    moved, factored = (2, 2, 0), (2 * 4 + 4 + 2, 2 * 2 + 2 + 2, 1)
    seen, learned = (2 * 2 + 1, 2 + 1, 0), (2 * 3 + 2, 2 + 2, 2 * 2 + 2)
    parts = (predicted, innovation, corrected, signal, moved, factored, seen, learned)
    assert one.written.cost == tuple(map(sum, zip(*parts, strict=True)))
