"""Stretches of millions of samples against a plain loop, however the samples are cut into blocks."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict
from becalm.report.data.envelope import Envelope, Means, Stretches, VerdictsByStretch

VALUES = st.lists(st.one_of(st.just(float("nan")), st.floats(-1e6, 1e6)), min_size=1, max_size=60)
CODES = st.lists(st.integers(0, max(Verdict)), min_size=1, max_size=60)
MOST = st.integers(1, 70)
CUTS = st.lists(st.integers(0, 60), max_size=6)


def blocks(values: list[float] | list[int], cuts: list[int]) -> list[slice]:
    """Cut a sequence at some places; blocks may be empty."""
    places = [0, *sorted(min(cut, len(values)) for cut in cuts), len(values)]
    return [slice(start, stop) for start, stop in itertools.pairwise(places)]


def stretches(count: int, most: int) -> list[slice]:
    """Say which samples each stretch has, in plain words."""
    each = max(1, -(-count // most))
    return [slice(start, start + each) for start in range(0, count, each)]


@given(values=VALUES, most=MOST, cuts=CUTS)
def test_an_envelope_is_the_least_and_the_greatest(values: list[float], most: int, cuts: list[int]) -> None:
    every, cutting = np.array(values), Stretches(len(values), most)
    found = Envelope(cutting.count)
    for block in blocks(values, cuts):
        found.add(*cutting.next(len(every[block])), every[block], every[block])
    parts = [every[part][~np.isnan(every[part])] for part in stretches(len(values), most)]
    assert len(found.low) == len(parts) <= most
    np.testing.assert_array_equal(found.low, [part.min() if len(part) else np.nan for part in parts])
    np.testing.assert_array_equal(found.high, [part.max() if len(part) else np.nan for part in parts])
    np.testing.assert_array_equal(Envelope.of(every, most).low, found.low)
    np.testing.assert_array_equal(Envelope.of(every, most).high, found.high)


@given(values=VALUES, most=MOST, cuts=CUTS)
def test_means_are_of_what_came(values: list[float], most: int, cuts: list[int]) -> None:
    every, cutting = np.array(values), Stretches(len(values), most)
    found = Means(cutting.count)
    for block in blocks(values, cuts):
        found.add(*cutting.next(len(every[block])), every[block])
    parts = [every[part][~np.isnan(every[part])] for part in stretches(len(values), most)]
    np.testing.assert_array_equal(found.seen, [len(part) for part in parts])
    expected = [part.mean() if len(part) else np.nan for part in parts]
    np.testing.assert_allclose(found.result(), expected, rtol=1e-12, atol=1e-8)


@given(codes=CODES, most=MOST, cuts=CUTS)
def test_kinds_are_those_that_came_up(codes: list[int], most: int, cuts: list[int]) -> None:
    every, cutting = np.array(codes, np.int8), Stretches(len(codes), most)
    found = VerdictsByStretch(cutting.count)
    for block in blocks(codes, cuts):
        found.add(*cutting.next(len(every[block])), every[block])
    parts = stretches(len(codes), most)
    for code in range(1, max(Verdict) + 1):
        first, after = found.runs(code)
        inside = {k for start, stop in zip(first, after, strict=True) for k in range(start, stop)}
        assert inside == {k for k, part in enumerate(parts) if code in codes[part]}
        assert (first[1:] > after[:-1]).all(), "runs that touch are one"
    assert not len(found.runs(Verdict.USED)[0]), "what was used is no news"


def test_every_verdict_has_a_bit() -> None:
    assert max(Verdict) <= 15


@pytest.mark.parametrize("place", [0, 1, 333_333, 999_999])
def test_a_spike_of_one_sample_survives(place: int) -> None:
    values: Floats = np.random.default_rng(1).normal(size=1_000_000)
    values[place] = 40.0
    found = Envelope.of(values, 3000)
    assert len(found.high) <= 3000
    at = int(np.argmax(found.high))
    assert found.high[at] == 40.0
    assert place // Stretches(len(values), 3000).rows_each == at
