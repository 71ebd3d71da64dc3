"""A hole changes nothing that is found: one cell emptied anywhere keeps tones and verdict, and many keep the tones."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.cleaning.channels.report import ChannelReport
from becalm.cleaning.pipeline import clean
from becalm.cleaning.tuning import Wishes, tune
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.identification.imputation import completed, nearly_complete
from becalm.identification.likelihood import Evidence, Tuning

ROWS, RATE_HZ = 3000, 100.0
RESOLUTION_HZ = RATE_HZ / ROWS
KINDS = ("two tones", "a slow tone", "no tone", "a fast tone")
K = np.arange(ROWS)


def record(kind: str) -> Floats:
    rng = np.random.default_rng(KINDS.index(kind))
    noise, walk = rng.normal(size=ROWS), np.cumsum(0.02 * rng.normal(size=ROWS))
    records: dict[str, Floats] = {
        "two tones": walk + np.sin(0.2003 * K) + 0.5 * np.sin(0.7001 * K + 1) + 0.5 * noise,
        "a slow tone": walk + 3 * np.sin(0.05 * K) + 0.3 * noise,
        "no tone": walk + noise,
        "a fast tone": walk + np.sin(2.5 * K) + 0.3 * noise,
    }
    return records[kind]


def found(z: Floats, causal: bool) -> ChannelReport:
    return clean(Recording(z, rate_hz=RATE_HZ), causal=causal).reports[0]


@cache
def complete(kind: str, causal: bool) -> ChannelReport:
    return found(record(kind), causal)


@settings(max_examples=12, deadline=None)
@given(st.sampled_from(KINDS), st.integers(0, ROWS - 1), st.booleans())
def test_one_cell_emptied_changes_no_tone_and_no_verdict(kind: str, row: int, causal: bool) -> None:
    z = record(kind)
    z[row] = np.nan
    holed, whole = found(z, causal), complete(kind, causal)
    assert holed.verdict == whole.verdict
    assert len(holed.tones_hz) == len(whole.tones_hz)
    assert len(whole.tones_hz) == 2 or kind != "two tones"
    np.testing.assert_allclose(sorted(holed.tones_hz), sorted(whole.tones_hz), atol=RESOLUTION_HZ)


@pytest.mark.parametrize("holes", ["every 37th", "one of 20", "a tenth at random"])
def test_many_holes_leave_the_tones(holes: str) -> None:
    z = record("two tones")
    z[{"every 37th": K % 37 == 0, "one of 20": (K >= 1000) & (K < 1020)}.get(holes, K * 7919 % 10 == 3)] = np.nan
    np.testing.assert_allclose(
        sorted(found(z, True).tones_hz), sorted(complete("two tones", True).tones_hz), atol=RESOLUTION_HZ
    )


def test_named_tones_are_taken_off_though_cells_are_empty() -> None:
    z = record("two tones")
    z[[700, 1500, 2300]] = np.nan
    recipe = tune(Recording(z, rate_hz=RATE_HZ), wishes=Wishes(removed_hz=(11.14,)))
    assert [tone.frequency_hz for tone in recipe.channel[0].tone if tone.disturbance] == [
        pytest.approx(11.14, abs=0.03)
    ]


def evidence_of(z: Floats, elapsed: Floats | None = None) -> Evidence:
    return Evidence.of(z, np.ones(len(z)) if elapsed is None else elapsed)


def test_only_what_is_nearly_complete_is_completed() -> None:
    tuning, z = Tuning(1, 1e-3, 1.0, ROWS), record("no tone")
    whole = evidence_of(z)
    assert completed(whole, tuning) is whole
    few = z.copy()
    few[[5, 1000, 1001]] = np.nan
    filled = completed(evidence_of(few), tuning)
    assert filled.complete == [slice(0, ROWS)]
    assert np.array_equal(filled.z[np.isfinite(few), 0], few[np.isfinite(few)])
    assert few[np.isfinite(few)].min() <= filled.z.min() <= filled.z.max() <= few[np.isfinite(few)].max()
    for odd in (np.where(K % 3 > 0, z, np.nan), np.where((K > 1000) & (K < 1100), np.nan, z)):
        kept = evidence_of(odd)
        assert completed(kept, tuning) is kept
    uneven = evidence_of(z, np.random.default_rng(1).uniform(0.5, 1.5, ROWS))
    assert completed(uneven, tuning) is uneven
    part = nearly_complete(uneven)
    assert part.stop - part.start < 10
