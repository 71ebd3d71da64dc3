"""The median of five neighbours, at the ends of a record and across the pieces it is taken in."""

import numpy as np

from becalm.core.arrays import Floats
from becalm.identification.spectrum import running_median


def noise(rows: int = 4000) -> Floats:
    return np.random.default_rng(0).normal(size=rows)


def test_the_running_median_is_that_of_five_neighbours() -> None:
    z = noise()
    found = running_median(z)
    for row in (2, 3, 2000, 3997):
        assert found[row] == np.median(z[row - 2 : row + 3])
    assert found[0] == found[1] == np.median(z[:5])
    assert found[-1] == np.median(z[-5:])


def test_pieces_make_no_difference() -> None:
    z = noise(200_000)
    assert np.array_equal(running_median(z)[65_000:67_000], running_median(z[64_990:67_010])[10:-10])
