"""Records that outliers are told in, and how they are."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.core.health.faults import Faults
from becalm.core.health.limits import Limits
from becalm.core.health.look_ahead import LookAhead
from becalm.core.health.outlier_rule import (
    Outliers,
)
from becalm.core.reading_verdicts import Verdict

ROWS = 4000


def noise(seed: int = 0, rows: int = ROWS) -> Floats:
    return np.random.default_rng(seed).normal(size=rows)


def found_causally(z: Floats, rule: Outliers) -> list[int]:
    codes = Faults(Limits(outliers=rule)).push(z, np.ones(len(z)))
    return np.flatnonzero(codes == Verdict.OUTLIER).tolist()


def stairs(rows: int = ROWS) -> Floats:
    """Return levels between which a sensor jumps, in noise."""
    rng = np.random.default_rng(4)
    return 50.0 + np.repeat(10 * rng.normal(size=rows // 200), 200) + 0.5 * rng.normal(size=rows)


def judged_soon(z: Floats, limits: Limits, ahead: int, cuts: list[int]) -> Codes:
    """Judge a record that is cut so, each row by so many after it; each part goes on from what was saved before it."""
    held, parts = LookAhead(limits, ahead), []
    for a, b in pairwise([0, *cuts, len(z)]):
        saved, held = held.state_dict(), LookAhead(limits, ahead)
        held.load_state_dict(saved)
        parts.append(held.push(z[a:b], np.ones(b - a)))
    assert sum(len(part[0]) for part in parts) == max(len(z) - ahead, 0), "no row waits for longer"
    rows, _, codes = (np.concatenate(arrays) for arrays in zip(*parts, held.finish(), strict=True))
    assert np.array_equal(rows, z, equal_nan=True)
    return np.asarray(codes, np.int8)
