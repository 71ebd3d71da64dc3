"""Noise terms recover what made a record, with honest errors; what a record cannot tell is said."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.model.components import level
from becalm.errors import RecordingError, UsageError
from becalm.identification.at_rest.allan import allan_deviation
from becalm.identification.at_rest.allan_covariance import shapes, spreads
from becalm.identification.at_rest.allan_terms import NoiseTerms, noise_terms

DATA = Path(__file__).parents[2].parent / "shared" / "data"
RATE = 100.0


def record(count: int, seed: int, quantisation: float = 0.0, white: float = 0.0, walk: float = 0.0) -> Floats:
    """Draw a record (count,) at RATE of Q, N and K."""
    rng, step = np.random.default_rng(seed), 1 / RATE
    drawn: Floats = (
        quantisation / step * np.diff(rng.normal(size=count + 1))
        + white / np.sqrt(step) * rng.normal(size=count)
        + walk * np.sqrt(step) * np.cumsum(rng.normal(size=count))
    )
    return drawn


def flicker(count: int, rng: np.random.Generator) -> Floats:
    """Draw bias instability of B = 1 by half an integration of white noise (Kasdin, Proc. IEEE 83, 1995, 802)."""
    n = 4 * count
    k = np.arange(1, n)
    weights = np.append(1.0, np.cumprod((k - 0.5) / k))
    spectrum = np.fft.rfft(weights, 2 * n) * np.fft.rfft(rng.normal(size=n), 2 * n)
    drawn: Floats = np.fft.irfft(spectrum)[n - count : n]
    return drawn


def terms(readings: Floats) -> NoiseTerms:
    return noise_terms(allan_deviation(readings, RATE))


def test_n_and_k_are_recovered_from_a_million_readings() -> None:
    """N within 2 %, K within 15 %."""
    found = terms(record(2**20, 0, white=0.1, walk=0.01))
    assert found.white.value == pytest.approx(0.1, rel=0.02)
    assert found.random_walk.value == pytest.approx(0.01, rel=0.15)
    assert np.isnan(found.quantisation.value)
    assert np.isnan(found.bias_instability.value)
    assert found.misfit < 1.5


def flat(count: int, seed: int) -> Floats:
    """Draw N = 0.1 and B = 0.2."""
    return record(count, seed, white=0.1) + 0.2 * flicker(count, np.random.default_rng(seed + 1000))


CASES: dict[str, tuple[Callable[[int], Floats], float]] = {
    "random_walk": (lambda seed: record(2**14, seed, white=0.1, walk=0.1), 0.1),
    "quantisation": (lambda seed: record(2**14, seed, quantisation=2e-3, white=0.01), 2e-3),
    "white": (lambda seed: record(2**12, seed, white=0.1), 0.1),
    "bias_instability": (lambda seed: flat(2**14, seed), 0.2),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_standard_errors_are_those_of_forty_records(name: str) -> None:
    """The mean is unbiased, and errors are 0.5 to 1.4 of what is claimed; forty tell them to 16 % and 11 %."""
    draw, true = CASES[name]
    found = [getattr(terms(draw(seed)), name) for seed in range(40)]
    told = [term for term in found if np.isfinite(term.value)]
    assert len(told) >= 38
    pulls = np.array([(term.value - true) / term.standard_error for term in told])
    assert abs(pulls.mean()) < 0.4
    assert 0.5 < pulls.std() < 1.4
    assert np.mean([term.limit >= true for term in found]) > 0.85


@pytest.mark.parametrize("kind", range(4))
def test_the_spread_is_the_sum_over_all_lags(kind: int) -> None:
    """Every lag, every covariance from the autocovariance itself; 0.3 % of the product of both spreads."""
    count, sizes = 1500, np.array([1, 2, 7, 16, 64, 300, 750])
    counts = count + 1 - 2 * sizes
    spread = spreads(tuple(sizes.tolist()), tuple(counts.tolist()))[:, :, kind, kind]

    def autocovariance(lag: Floats) -> Floats:
        t = np.abs(lag)
        log = np.log(np.where(t > 0, t, 1.0))
        every: list[Floats] = [(t == 0).astype(float), -t / 2, t**2 * log / (2 * np.pi), (t**3 - t) / 12]
        return every[kind]

    for i, m in enumerate(sizes):
        for j, n in enumerate(sizes):
            lags = np.arange(1.0 - counts[i], counts[j])
            pairs = np.minimum(counts[i], counts[j] - lags) - np.maximum(0, -lags)
            bends = enumerate((1, -2, 1))
            c = sum(a * b * autocovariance(lags + k * n - h * m) for h, a in bends for k, b in enumerate((1, -2, 1)))
            expected = 2 * np.sum(pairs * c**2) / (counts[i] * counts[j] * (2.0 * m * n) ** 2)
            assert spread[i, j] == pytest.approx(expected, abs=3e-3 * np.sqrt(spread[i, i] * spread[j, j]))


def test_one_degree_of_freedom_is_left_at_half_of_the_record() -> None:
    """One square of one Gaussian: its variance is twice its squared mean."""
    sizes = np.array([50])
    spread = spreads((50,), (1,))[0, 0]
    np.testing.assert_allclose(np.diag(spread), 2 * shapes(sizes)[0] ** 2, rtol=1e-9)


def test_what_the_record_cannot_tell_is_said_with_a_bound() -> None:
    found = terms(record(2**12, 0, white=0.1))
    assert np.isnan(found.random_walk.value)
    assert np.isnan(found.random_walk.standard_error)
    assert "longer record" in found.random_walk.reason
    assert "no flat stretch" in found.bias_instability.reason
    assert "quantisation" in found.quantisation.reason
    assert found.white.reason == ""
    with pytest.raises(UsageError, match="does not rise"):
        found.to_random_walk_density()


def test_a_random_walk_louder_than_all_leaves_white_noise_untold() -> None:
    found = terms(record(2**12, 0, walk=1.0))
    assert found.random_walk.value == pytest.approx(1.0, rel=0.1)
    with pytest.raises(UsageError, match="not loud enough"):
        found.to_noise_variance(RATE)


def test_a_longer_record_bounds_the_random_walk_lower() -> None:
    short, long = terms(record(2**10, 1, white=0.1)), terms(record(2**16, 1, white=0.1))
    assert long.random_walk.limit < short.random_walk.limit / 20


def test_a_vibration_that_no_term_describes_is_a_misfit() -> None:
    x = record(2**14, 2, white=0.1)
    shaken = x + np.sin(2 * np.pi * 0.7 * np.arange(len(x)) / RATE)
    assert terms(x).misfit < 1.5
    assert terms(shaken).misfit > 2


def test_r_and_q_make_the_filters_model() -> None:
    """R is the variance of one reading, and Q over a step that of one step of the walk."""
    found = terms(record(2**18, 3, white=0.1, walk=0.02))
    model = level(found.to_random_walk_density()).to_model(1 / RATE, found.to_noise_variance(RATE))
    assert model.R[0, 0] == pytest.approx(0.1**2 * RATE, rel=0.04)
    assert model.process_covariance[0, 0] == pytest.approx(0.02**2 / RATE, rel=0.4)


def test_the_deviation_of_the_terms_is_the_textbooks() -> None:
    found = terms(record(2**18, 4, white=0.1, walk=0.02))
    times = np.array([1.0, 10.0, 300.0])
    expected = np.sqrt(found.white.value**2 / times + found.random_walk.value**2 * times / 3)
    np.testing.assert_allclose(found.deviation(times), expected, rtol=1e-4)


def test_gaps_do_not_bias_the_terms() -> None:
    x = record(2**18, 5, white=0.1, walk=0.02)
    x[np.random.default_rng(5).integers(0, len(x), 20)] = np.nan
    found = terms(x)
    assert found.white.value == pytest.approx(0.1, rel=0.02)
    assert found.random_walk.value == pytest.approx(0.02, rel=0.3)


@given(power=st.integers(-100, 100))
@settings(max_examples=20)
def test_the_unit_does_not_matter(power: int) -> None:
    x, scale = record(2**10, 6, white=0.1, walk=0.1), 10.0**power
    plain, other = terms(x), terms(scale * x)
    assert other.white.value == pytest.approx(scale * plain.white.value, rel=1e-6)
    assert other.random_walk.standard_error == pytest.approx(scale * plain.random_walk.standard_error, rel=1e-5)
    assert other.misfit == pytest.approx(plain.misfit, rel=1e-6)


ALONE = [(part, count) for part in ("quantisation", "white", "walk") for count in (64, 65, 100, 1000)]


@pytest.mark.parametrize(("part", "count"), [*ALONE, ("walk", 3_000_000)])
def test_every_kind_alone_is_told_at_every_length(part: str, count: int) -> None:
    found = terms(record(count, 7, **{part: 0.3}))
    name = "random_walk" if part == "walk" else part
    assert getattr(found, name).value == pytest.approx(0.3, rel=0.6)


def test_too_few_cluster_times_are_refused() -> None:
    with pytest.raises(RecordingError, match="64 readings"):
        terms(record(63, 8, white=1.0))


def test_a_constant_is_refused() -> None:
    with pytest.raises(RecordingError, match="do not change"):
        terms(np.full(1000, 3.0))


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(UsageError, match=r"rate_hz = .* is not possible; give a positive number"):
        terms(record(100, 9, white=1.0)).to_noise_variance(rate)


@pytest.mark.parametrize("channel", [1, 2, 3])
def test_a_gyroscope_at_rest_has_the_white_noise_of_its_quiet_differences(channel: int) -> None:
    """Half the mean square of differences is the variance of white noise, whatever wanders below; 20 % is colour."""
    path = DATA / "imu_tk" / "xsens_gyro.mat.txt.gz"
    if not path.exists():
        pytest.skip("the recordings are not beside the project (imu_tk)")
    counts = np.loadtxt(path, max_rows=3800)[:, channel]
    found = terms(counts)
    assert found.to_noise_variance(RATE) == pytest.approx(np.mean(np.diff(counts) ** 2) / 2, rel=0.2)
    assert found.misfit < 3
