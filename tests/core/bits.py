"""The same numbers to the last bit, the sign of a zero and the payload of a NaN among them."""

from __future__ import annotations

import numpy as np

from becalm.core.arrays import Floats


def same_bits(got: Floats, expected: Floats) -> bool:
    one, other = (np.ascontiguousarray(values).view(np.uint64) for values in (got, expected))
    return got.shape == expected.shape and np.array_equal(one, other)


def assert_same_bits(got: Floats, expected: Floats) -> None:
    assert got.shape == expected.shape
    assert same_bits(got, expected)
