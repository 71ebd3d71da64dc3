"""Which sensors are unlike the others of their class, by how large something of them is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from becalm.fleet.class_outliers import FACTOR, FEWEST, class_of, factors_apart, mark_outliers, times
from becalm.fleet.outcome import Outcome, refused
from becalm.report.fleet.fleet_rows import FleetRow


def test_a_class_is_the_folder_that_sensors_are_in() -> None:
    assert class_of("kind=pump/sensor=17") == "kind=pump"
    assert class_of("plant=3/kind=pump/17.parquet") == "plant=3/kind=pump"
    assert class_of("sensor=17") == class_of(".") == "default"


@given(
    st.lists(st.floats(-1, 1), min_size=FEWEST, max_size=40),
    st.floats(FACTOR + 1, 50),
    st.floats(1e-6, 1e6),
    st.data(),
)
def test_one_that_is_apart_is_told_in_any_unit(
    logs: list[float], factor: float, unit: float, data: st.DataObject
) -> None:
    place = data.draw(st.integers(0, len(logs)))
    spread = np.array(logs) * math.log(factor) / 50  # a fiftieth of it at most
    sizes = (unit * np.exp(np.insert(spread, place, math.log(factor)))).tolist()
    told = factors_apart(sizes)
    assert [k for k, one in enumerate(told) if one is not None] == [place]
    assert told[place] == pytest.approx(factor, rel=0.2)
    inverse = factors_apart([1 / size for size in sizes])
    assert inverse[place] == pytest.approx(1 / factor, rel=0.2)


@given(st.lists(st.floats(1, FACTOR), max_size=40))
def test_a_class_within_the_factor_has_none(sizes: list[float]) -> None:
    assert factors_apart(sizes) == [None] * len(sizes)


def test_a_class_that_scatters_has_none_within_it() -> None:
    sizes = np.random.default_rng(1).lognormal(0, 0.5, 200).tolist()
    assert not any(factors_apart(sizes))
    assert [one is not None for one in factors_apart([*sizes, 30.0])] == [False] * 200 + [True]


def test_few_sensors_and_unknown_sizes_tell_nothing() -> None:
    assert factors_apart([1.0] * (FEWEST - 2) + [9.0]) == [None] * (FEWEST - 1)
    sizes = [1.0] * FEWEST + [0.0, math.nan, math.inf, 9.0]
    assert factors_apart(sizes) == [None] * (FEWEST + 3) + [pytest.approx(9.0)]


def rows_of(health: Sequence[float | None], folder: str = "", **told: Any) -> list[Outcome]:
    usual: dict[str, Any] = {"channel": "v", "unit": "V", "verdict": "fits", "recipe": "abc"}
    names = [f"{folder}s={k}" for k in range(len(health))]
    return [
        Outcome(name, "cleaned", (FleetRow(name, health=nis, **{**usual, **told}),))
        for name, nis in zip(names, health, strict=True)
    ]


def test_cleaning_marks_those_whose_innovations_are_unlike_their_class() -> None:
    outcomes = [
        *rows_of([1.0] * 9 + [9.0, None]),
        *rows_of([4.0] * 9, "kind=a/"),
        *rows_of([1.0] * 9 + [0.04], "kind=b/", recipe="own"),
        *rows_of([1.0] * 6 + [9.0], "kind=c/"),
        *rows_of([1.0] * 9 + [9.0], "kind=d/")[:9],
        *rows_of([1.0] * 9 + [9.0], "kind=d/", recipe="its own")[9:],
        refused("kind=a/s=77", "It is rubbish."),
    ]
    told = {row.sensor: row.outlying for outcome in mark_outliers(outcomes) for row in outcome.channels if row.outlying}
    assert told == {
        "s=9": "Its innovations are 3 times those of its class with the same recipe: it is noisier, or moves more.",
        "kind=b/s=9": "Its innovations are 0.2 times those of its class with the same recipe:"
        " it is quieter, or moves less.",
    }


def test_factors_are_said_as_people_write_them() -> None:
    told = [times(factor) for factor in (0.0123, 1.0, 3.16, 99.4, 99.6, 1234.5, 2e7)]
    assert told == ["0.012 times", "1 times", "3.2 times", "99 times", "100 times", "1234 times", "2e+07 times"]
