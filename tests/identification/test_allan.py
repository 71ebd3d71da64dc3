"""The Allan deviation equals published and independent values, and its intervals hold the truth."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.errors import RecordingError, UsageError
from becalm.identification.at_rest.allan import AllanCurve, allan_deviation

NINE = [892.0, 809.0, 823.0, 798.0, 671.0, 644.0, 883.0, 903.0, 677.0]


def portable_thousand() -> Floats:
    """Return Riley's 1000 numbers, from a multiplicative congruential generator."""
    state, numbers = 1234567890, []
    for _ in range(1000):
        numbers.append(state / 2147483647)
        state = 16807 * state % 2147483647
    return np.array(numbers)


def flicker(count: int, rng: np.random.Generator) -> Floats:
    """Draw noise of spectrum 1 / (2 pi f) by half an integration of white noise (Kasdin, Proc. IEEE 83, 1995, 802)."""
    n = 8 * count
    k = np.arange(1, n)
    weights = np.append(1.0, np.cumprod((k - 0.5) / k))
    spectrum = np.fft.rfft(weights, 2 * n) * np.fft.rfft(rng.normal(size=n), 2 * n)
    drawn: Floats = np.fft.irfft(spectrum)[n - count : n]
    return drawn


def by_averages(readings: Floats, m: int) -> float:
    """Average, subtract, square: the definition, cluster by cluster."""
    pairs = [
        (readings[k + m : k + 2 * m].mean() - readings[k : k + m].mean()) ** 2 for k in range(len(readings) - 2 * m + 1)
    ]
    return float(np.sqrt(np.nanmean(pairs) / 2))


def test_nine_numbers_of_the_handbook() -> None:
    """NIST SP 1065, section 12.3, the data of NBS Monograph 140: seven digits are published."""
    found = allan_deviation(NINE, 1.0, [1.0, 2.0]).deviation
    assert found == pytest.approx([91.22945, 85.95287], rel=5e-8)


def test_a_thousand_numbers_of_the_handbook() -> None:
    """NIST SP 1065, section 12.4."""
    found = allan_deviation(portable_thousand(), 1.0, [1.0, 10.0, 100.0]).deviation
    assert found == pytest.approx([2.922319e-01, 9.159953e-02, 3.241343e-02], rel=2e-7)


@pytest.mark.parametrize("offset", [0.0, 9.81])
def test_allantools_agrees(offset: float) -> None:
    allantools = pytest.importorskip("allantools")
    rng = np.random.default_rng(0)
    x = offset + rng.normal(size=2**17) + 0.01 * np.cumsum(rng.normal(size=2**17))
    found = allan_deviation(x, 200.0)
    times, theirs, _, counts = allantools.oadev(x, rate=200.0, data_type="freq", taus=found.cluster_times_s)
    np.testing.assert_allclose(found.deviation[: len(times)], theirs, rtol=1e-12)
    assert np.array_equal(found.counts[: len(times)], counts)


def test_it_is_its_definition() -> None:
    x = np.random.default_rng(1).normal(size=97) + 5.0
    found = allan_deviation(x, 50.0, [m / 50 for m in (1, 2, 3, 7, 20, 48)])
    expected = [by_averages(x, m) for m in (1, 2, 3, 7, 20, 48)]
    np.testing.assert_allclose(found.deviation, expected, rtol=1e-12)
    assert np.array_equal(found.counts, [96, 94, 92, 84, 58, 2])


def test_averages_across_a_gap_are_left_out_and_no_others() -> None:
    x = np.random.default_rng(2).normal(size=90) - 3.0
    x[[20, 21, 50]] = [np.nan, np.inf, np.nan]
    x_with_nan = np.where(np.isfinite(x), x, np.nan)
    found = allan_deviation(x, 1.0, [1.0, 4.0, 10.0])
    assert found.deviation == pytest.approx([by_averages(x_with_nan, m) for m in (1, 4, 10)], rel=1e-12)
    assert np.array_equal(found.counts, [19 + 27 + 38, 13 + 21 + 32, 1 + 9 + 20])
    assert allan_deviation(x, 1.0).cluster_times_s.max() == 16.0


def test_a_gap_costs_degrees_of_freedom() -> None:
    x = np.random.default_rng(3).normal(size=4000)
    holed = x.copy()
    holed[2000] = np.nan
    whole, apart = allan_deviation(x, 1.0), allan_deviation(holed, 1.0)
    shared = slice(0, len(apart.deviation))
    assert (apart.degrees_of_freedom < whole.degrees_of_freedom[shared]).all()
    assert apart.degrees_of_freedom[0] == pytest.approx(whole.degrees_of_freedom[0], rel=2e-3)


@given(offset=st.floats(-1e3, 1e3), scale=st.integers(-60, 60).map(lambda power: 10.0**power))
@settings(max_examples=30)
def test_an_offset_adds_nothing_and_a_unit_scales(offset: float, scale: float) -> None:
    x = np.random.default_rng(4).normal(size=300)
    plain, other = allan_deviation(x, 10.0), allan_deviation(scale * (x + offset), 10.0)
    np.testing.assert_allclose(other.deviation, scale * plain.deviation, rtol=1e-9)
    np.testing.assert_allclose(other.high, scale * plain.high, rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "expected"),
    [("octave", [1, 2, 4, 8, 16, 32, 64, 128, 256, 512]), ("decade", [1, 2, 5, 10, 20, 50, 100, 200, 500])],
)
def test_the_series_go_up_to_half_of_the_record(name: str, expected: list[int]) -> None:
    found = allan_deviation(np.random.default_rng(5).normal(size=1024), 4.0, name)
    assert np.array_equal(found.cluster_sizes, expected)
    assert found.cluster_times_s == pytest.approx(np.array(expected) / 4.0, rel=1e-15)


KINDS: dict[str, tuple[int, Callable[[int, np.random.Generator], Floats], Callable[[Floats], Floats]]] = {
    "quantisation": (2, lambda n, rng: np.diff(rng.normal(size=n + 1)), lambda m: 3 / m**2),
    "white": (0, lambda n, rng: rng.normal(size=n), lambda m: 1 / m),
    "flicker": (-1, flicker, lambda m: np.full(len(m), 2 * np.log(2) / np.pi)),
    "walk": (-2, lambda n, rng: np.cumsum(rng.normal(size=n)), lambda m: m / 3 + 1 / (6 * m)),
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_kind_of_noise_is_told_and_the_intervals_hold_its_deviation(kind: str) -> None:
    """95 % of intervals do, of 300 records, within five standard errors of that share, and the kind of noise known."""
    exponent, draw, variance = KINDS[kind]
    rng = np.random.default_rng(6)
    curves: list[AllanCurve] = [allan_deviation(draw(2048, rng), 1.0) for _ in range(300)]
    sizes = curves[0].cluster_sizes
    for k in range(3, len(sizes)):  # sampled flicker is louder than 1/f up to four steps
        true = float(np.sqrt(variance(sizes[k : k + 1].astype(float))[0]))
        inside = np.mean([curve.low[k] <= true <= curve.high[k] for curve in curves])
        assert 0.89 <= inside <= 0.99
    assert np.mean([curve.noise_exponent[0] == exponent for curve in curves]) > 0.99


def test_a_smaller_confidence_narrows_the_intervals() -> None:
    x = np.random.default_rng(7).normal(size=500)
    wide, narrow = allan_deviation(x, 1.0), allan_deviation(x, 1.0, confidence=0.5)
    assert (wide.low < narrow.low).all()
    assert (narrow.high < wide.high).all()
    assert (narrow.low < narrow.deviation).all()


def test_a_constant_record_has_no_deviation() -> None:
    found = allan_deviation(np.full(100, 7.3), 1.0)
    assert not found.deviation.any()
    assert not found.high.any()


def test_two_readings_are_enough() -> None:
    found = allan_deviation([1.0, 3.0], 1.0)
    assert found.deviation == pytest.approx([np.sqrt(2)])
    assert np.array_equal(found.degrees_of_freedom, [1.0])


def test_the_record_is_not_changed_and_the_curve_cannot_be() -> None:
    x = np.random.default_rng(8).normal(size=100)
    before = x.copy()
    found = allan_deviation(x, 1.0)
    assert np.array_equal(x, before)
    with pytest.raises(ValueError, match="read-only"):
        found.deviation[0] = 0.0


def test_a_million_readings_keep_their_digits_far_from_zero() -> None:
    """The cumulative sum of a million readings at 1e6 is 1e12; nothing of the noise may be lost in it."""
    x = np.random.default_rng(9).normal(size=1_000_000)
    near, far = allan_deviation(x, 100.0), allan_deviation(x + 1e6, 100.0)
    assert near.cluster_sizes[-1] == 2**18
    np.testing.assert_allclose(far.deviation, near.deviation, rtol=1e-7)
    assert near.deviation[:10] == pytest.approx(near.cluster_sizes[:10] ** -0.5, rel=0.1)


@pytest.mark.parametrize(
    ("readings", "sentence"),
    [
        ([[1.0, 2.0]], "one channel"),
        (["a", "b"], "not numbers"),
        ([1.0 + 2j, 0.0], "real numbers are needed"),
        ([], "consecutive readings"),
        ([1.0, np.nan, 2.0, np.nan], "consecutive readings"),
    ],
)
def test_what_is_no_record_is_refused(readings: list[object], sentence: str) -> None:
    with pytest.raises(RecordingError, match=sentence):
        allan_deviation(readings, 1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"rate_hz": 0.0}, "is not a rate"),
        ({"rate_hz": np.nan}, "is not a rate"),
        ({"confidence": 1.0}, "not between 0 and 1"),
        ({"cluster_times_s": "hexadecimal"}, "use 'octave', 'decade'"),
        ({"cluster_times_s": [0.015]}, "the nearest is 0.02 s"),
        ({"cluster_times_s": [0.6]}, "give 0.01 to 0.5 s"),
        ({"cluster_times_s": [0.0]}, "is not possible"),
        ({"cluster_times_s": [np.nan]}, "is not possible"),
        ({"cluster_times_s": []}, "is empty"),
        ({"cluster_times_s": [0.3]}, "twice as long as 0.3 s"),
    ],
)
def test_what_cannot_be_had_is_refused_in_a_sentence(arguments: dict[str, object], sentence: str) -> None:
    x = np.random.default_rng(10).normal(size=100)
    x[50] = np.nan
    with pytest.raises(UsageError, match=re.escape(sentence)):
        allan_deviation(x, **{"rate_hz": 100.0, **arguments})  # type: ignore[arg-type]
