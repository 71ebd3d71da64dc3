"""Frames come out as they went in, where a page's typed arrays can lie over them."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from becalm.web.frames import Relative, frame, relative, text, unframed

KINDS = {"f4": np.float32, "f8": np.float64, "u2": np.uint16}
anything = st.sampled_from(sorted(KINDS)).flatmap(lambda kind: hnp.arrays(KINDS[kind], st.integers(0, 20)))


@given(st.dictionaries(st.text(min_size=1, max_size=8), anything, max_size=5), st.text(max_size=30))
def test_arrays_of_every_kind_come_back(arrays: dict[str, NDArray[Any]], says: str) -> None:
    header, found = unframed(frame({"kind": "picture", "says": says}, arrays))
    assert header == {"kind": "picture", "says": says}
    assert list(found) == list(arrays)
    for name, values in arrays.items():
        assert found[name].dtype == values.dtype
        np.testing.assert_array_equal(found[name], values)


@given(st.text(max_size=30), st.integers(0, 9), st.integers(0, 9))
def test_every_array_lies_on_eight_bytes(says: str, first: int, second: int) -> None:
    data = frame({"says": says}, {"a": np.ones(first, np.uint16), "b": np.ones(second, np.float64)})
    (length,) = struct.unpack_from("<I", data)
    told = json.loads(data[4 : 4 + length])["arrays"]
    assert (4 + length) % 8 == 0
    assert [each["at"] % 8 for each in told.values()] == [0, 0]
    assert len(data) % 8 == 0
    assert told["b"] == {"type": "f8", "at": told["b"]["at"], "count": second}


def test_a_small_signal_on_a_large_offset_keeps_its_digits() -> None:
    values = 1e6 + np.sin(np.arange(100) / 9)
    values[3] = np.nan
    header, found = unframed(frame({}, {"clean": relative(values)}))
    assert header == {}
    np.testing.assert_allclose(found["clean"], values, rtol=0, atol=1e-7)
    assert np.abs(values.astype(np.float32) - values)[4:].max() > 1e-3  # as it would be without


@pytest.mark.parametrize("value", [1e300, -1e300, 3.3e38])
def test_what_float32_does_not_hold_stays_float64(value: float) -> None:
    values = np.array([value, 1.0])
    found = unframed(frame({}, {"raw": relative(values)}))[1]["raw"]
    np.testing.assert_array_equal(found, values)


@pytest.mark.parametrize("values", [[], [np.nan, np.nan], [np.inf, -np.inf]])
def test_nothing_finite_has_no_middle(values: list[float]) -> None:
    found = relative(np.array(values))
    assert isinstance(found, Relative)
    assert found.offset == 0
    np.testing.assert_array_equal(found.values, values)


def test_a_type_that_pages_do_not_read_is_refused() -> None:
    with pytest.raises(TypeError, match="rows is int64"):
        frame({}, {"rows": np.arange(3)})  # type: ignore[dict-item]


def test_what_is_not_finite_is_null() -> None:
    told = json.loads(text({"a": np.nan, "b": [1.5, (np.inf,)], "c": {"d": -np.inf, "e": "NaN"}, "f": None}))
    assert told == {"a": None, "b": [1.5, [None]], "c": {"d": None, "e": "NaN"}, "f": None}
