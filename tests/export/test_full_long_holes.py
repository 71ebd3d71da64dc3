"""A filter that has settled, and then meets a hole: its covariance as a constant has all of its digits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from driven import driven_one
from exported import bundle, channel


@pytest.mark.parametrize(("order", "cutoff"), [(1, 0.05), (2, 1e-3), (3, 5e-3), (4, 0.05)])
def test_after_a_hole_a_settled_filter_is_becalm(order: int, cutoff: float, tmp_path: Path) -> None:
    told = channel("ax", order, cutoff)
    held = driven_one(bundle(told, precision="float64", gain="full"), tmp_path)
    one = held.one
    rng = np.random.default_rng(3)
    before = rng.normal(size=min(one.design.settled_rows, 60_000) + 100)
    readings = np.concatenate([before, np.full(300, np.nan), 5 + rng.normal(size=3000)])
    signal, _ = held.run(readings)
    want, _ = one.kind.reference(told, one.design, one.written).run(readings)
    assert np.abs(signal - want)[len(before) :].max() <= 1e-12 * np.abs(want).max()
