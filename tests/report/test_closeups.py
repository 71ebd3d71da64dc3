"""A few rows as they are: the right ones, wherever the record is cut."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.rows import EstimatedRows
from becalm.report.data.closeup import Closeup, Farthest, Middle

SHOWN = 600


def rows_of(rows: int, wild: int | None = None) -> tuple[Floats, Floats, EstimatedRows]:
    rng = np.random.default_rng(rows)
    signal, noise = np.cumsum(rng.normal(size=rows)), rng.normal(size=rows)
    if wild is not None:
        noise[wild] = 30.0
    told = EstimatedRows(signal, np.full(rows, 0.5), np.empty((0, rows)), np.zeros(rows, np.int8))
    return np.arange(rows) / 10, signal + noise, told


def shown(closeup: Closeup, rows: tuple[Floats, Floats, EstimatedRows], cuts: list[int]) -> Floats:
    times_s, z, told = rows
    places = [0, *sorted(min(cut, len(z)) for cut in cuts), len(z)]
    for start, stop in itertools.pairwise(places):
        part = slice(start, stop)
        closeup.add(times_s[part], z[part], told.rows(part))
    return closeup.kept


def expected(rows: tuple[Floats, Floats, EstimatedRows], first: int, after: int) -> Floats:
    times_s, z, told = rows
    return np.vstack([times_s, z, told.signal, told.sigma])[:, first:after]


@given(count=st.integers(1, 2000), cuts=st.lists(st.integers(0, 2000), max_size=5))
def test_the_middle_is_the_middle_wherever_the_record_is_cut(count: int, cuts: list[int]) -> None:
    rows = rows_of(count)
    first = max(0, (count - SHOWN) // 2)
    np.testing.assert_array_equal(shown(Middle(count), rows, cuts), expected(rows, first, first + SHOWN))


@given(wild=st.integers(0, 2999), cuts=st.lists(st.integers(0, 3000), max_size=4))
def test_the_farthest_reading_is_shown_with_what_is_about_it(wild: int, cuts: list[int]) -> None:
    rows = rows_of(3000, wild)
    kept = shown(Farthest(), rows, cuts)
    (at,) = np.flatnonzero(kept[0] == wild / 10)
    first = wild - int(at)
    np.testing.assert_array_equal(kept, expected(rows, first, first + kept.shape[1]))
    places = [0, *sorted(cuts), 3000]
    start = max(place for place in places if place <= wild)
    stop = min(place for place in places if place > wild)
    assert kept.shape[1] == min(SHOWN, stop - start), "as many as its block has"


def test_of_one_block_the_farthest_stands_in_the_middle() -> None:
    assert shown(Farthest(), rows_of(3000, 1700), [])[0, SHOWN // 2] == 170.0


def test_where_sigma_is_unknown_no_reading_is_far() -> None:
    times_s, z, told = rows_of(50, 7)
    kept = shown(Farthest(), (times_s, z, told._replace(sigma=np.full(50, np.nan))), [20])
    assert kept.shape == (4, 0)
