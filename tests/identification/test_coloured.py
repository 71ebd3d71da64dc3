"""The noise at rest: white stays white, coloured noise is found as it was drawn, a drift is neither."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from becalm.core.arrays import Floats
from becalm.core.closed_forms import autoregressive_power
from becalm.core.model.autoregressive import ColouredNoise
from becalm.core.model.components import motion
from becalm.errors import RecordingError
from becalm.identification.coloured import (
    LEAST_WHITE,
    LONGEST_CORRELATION,
    NoiseModel,
    Shape,
    _cosine_sum,
    exact_misfit,
    fit_noise,
    spectral_misfit,
)

RESONANCE = (2 * 0.95 * float(np.cos(0.5)), -(0.95**2))


def coloured(coefficients: tuple[float, ...], rows: int, rng: np.random.Generator) -> Floats:
    """Draw autoregressive noise of variance 1 that has been going on for long."""
    drive = np.sqrt(ColouredNoise(coefficients, 1.0).innovation_variance) * rng.normal(size=rows + 5000)
    return np.asarray(lfilter([1.0], [1.0, *(-phi for phi in coefficients)], drive)[5000:])


def fitted(coefficients: tuple[float, ...], rows: int, white: float, seeds: int) -> list[NoiseModel]:
    found = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        found.append(fit_noise([coloured(coefficients, rows, rng) + np.sqrt(white) * rng.normal(size=rows)]))
    return found


def assert_within_scatter(values: list[float], truth: float, most: float) -> None:
    """The mean within four of its standard errors, and the scatter itself no larger than foretold."""
    assert abs(np.mean(values) - truth) < 4 * np.std(values, ddof=1) / np.sqrt(len(values))
    assert np.std(values, ddof=1) < most


@pytest.mark.parametrize("phi", [(0.9,), RESONANCE, (0.5, -0.3, 0.2)])
def test_the_table_of_cosines_holds_the_power_of_coloured_noise(phi: tuple[float, ...]) -> None:
    """Beside its closed form, and the transform of autocovariances that the noise itself has."""
    angle = np.linspace(0.01, np.pi, 50)
    power = autoregressive_power(phi, 2.0, angle)
    table = np.cos(np.multiply.outer(np.arange(len(phi) + 1), angle))
    np.testing.assert_allclose(2.0 / (_cosine_sum(phi) @ table), power, rtol=1e-10)
    impulse = lfilter([1.0], [1.0, *(-one for one in phi)], np.eye(1, 4000)[0])
    waves = np.exp(-1j * np.outer(angle, np.arange(4000)))
    np.testing.assert_allclose(2.0 * np.abs(waves @ impulse) ** 2, power, rtol=1e-9)


@pytest.mark.parametrize("rows", [100, 1000, 20_000])
def test_white_noise_stays_white(rows: int) -> None:
    found = [fit_noise([0.3 * np.random.default_rng([seed, rows]).normal(size=rows)]) for seed in range(20)]
    assert sum(one.coloured is not None for one in found) <= 1
    ratios = [one.white_variance / 0.09 for one in found if one.coloured is None]
    assert_within_scatter(ratios, 1.0, 2 * np.sqrt(2 / rows))


def test_noise_of_order_one_is_found_beside_white() -> None:
    """Over ten records of 20 000 readings: of phi = 0.9, variance 1 and R = 1."""
    found = fitted((0.9,), 20_000, 1.0, 10)
    noises = [one.coloured for one in found if one.coloured is not None and len(one.coloured.coefficients) == 1]
    assert len(noises) >= 9
    assert_within_scatter([noise.coefficients[0] for noise in noises], 0.9, 0.015)
    assert_within_scatter([noise.variance for noise in noises], 1.0, 0.1)
    assert_within_scatter([one.white_variance for one in found], 1.0, 0.05)


def test_a_resonance_is_found() -> None:
    found = fitted(RESONANCE, 20_000, 0.25, 6)
    for one in found:
        assert one.coloured is not None
        assert len(one.coloured.coefficients) == 2
        assert one.gain > 1000
    noises = [one.coloured.coefficients for one in found if one.coloured is not None]
    np.testing.assert_allclose(np.mean(noises, axis=0), RESONANCE, rtol=0.01)
    assert np.mean([one.white_variance for one in found]) == pytest.approx(0.25, rel=0.05)


def test_noise_without_white_keeps_a_little_of_it() -> None:
    for one in fitted((0.5, 0.2, -0.3), 20_000, 0.0, 3):
        assert one.coloured is not None
        assert one.white_variance >= LEAST_WHITE * one.coloured.innovation_variance
        assert one.white_variance < 0.05
        np.testing.assert_allclose(one.coloured.coefficients, (0.5, 0.2, -0.3), atol=0.06)


DRIFTS: dict[str, Callable[[Floats, np.random.Generator], Floats]] = {
    "ramp": lambda t, rng: 10 * t,
    "half a sine": lambda t, rng: 5 * np.sin(np.pi * t),
    "two cycles": lambda t, rng: 5 * np.sin(4 * np.pi * t),
    "warming up": lambda t, rng: 10 * np.exp(-8 * t),
    "random walk": lambda t, rng: np.cumsum(0.03 * rng.normal(size=len(t))),
    "strong random walk": lambda t, rng: np.cumsum(0.3 * rng.normal(size=len(t))),
    "longer memory than can be told": lambda t, rng: coloured((1 - 2.5 / len(t),), len(t), rng),
}


@pytest.mark.parametrize("drift", list(DRIFTS.values()), ids=list(DRIFTS))
def test_a_drift_is_no_coloured_noise_and_no_white_noise(
    drift: Callable[[Floats, np.random.Generator], Floats],
) -> None:
    t, called = np.linspace(0, 1, 5000), 0
    for seed in range(3):
        rng = np.random.default_rng(seed)
        found = fit_noise([rng.normal(size=5000) + drift(t, rng)])
        called += found.coloured is not None
        assert found.white_variance == pytest.approx(1.0, abs=0.1)  # five standard errors, sqrt(2 / 5000)
    assert called == 0


def test_coloured_noise_is_found_on_top_of_a_drift() -> None:
    rng = np.random.default_rng(1)
    found = fit_noise(
        [coloured((0.8,), 20_000, rng) + 0.5 * rng.normal(size=20_000) + 9 * np.linspace(0, 1, 20_000) ** 2]
    )
    assert found.coloured is not None
    assert found.coloured.coefficients == pytest.approx((0.8,), abs=0.04)


def test_what_is_found_forgets_within_a_tenth_of_a_stretch() -> None:
    rng = np.random.default_rng(3)
    for memory in (3, 10, 1000):
        found = fit_noise([coloured((float(np.exp(-1 / memory)),), 2000, rng) + 0.1 * rng.normal(size=2000)])
        assert (found.coloured is not None) == (memory < 1000)
        if found.coloured is not None:
            assert (
                -1 / np.log(np.abs(np.roots([1, *(-p for p in found.coloured.coefficients)])).max())
                < LONGEST_CORRELATION * 2000
            )


def test_several_stretches_of_levels_of_their_own_tell_one_noise() -> None:
    rng = np.random.default_rng(4)
    parts = [coloured((0.9,), 2000, rng) + rng.normal(size=2000) + level for level in (0.0, 1e4, -50.0, 7.0, 2.0)]
    found = fit_noise(parts)
    assert found.coloured is not None
    assert found.coloured.coefficients == pytest.approx((0.9,), abs=0.06)
    assert found.white_variance == pytest.approx(1.0, rel=0.15)


@pytest.mark.parametrize("share", [0.004, 0.2])
def test_missing_readings_do_not_colour_the_noise(share: float) -> None:
    rng = np.random.default_rng(6)
    white, red = rng.normal(size=4000), coloured((0.9,), 4000, rng) + rng.normal(size=4000)
    missing = rng.random(4000) < share
    white[missing], red[missing] = np.nan, np.inf
    assert fit_noise([white]).coloured is None
    found = fit_noise([red])
    assert found.coloured is not None
    assert found.coloured.coefficients == pytest.approx((0.9,), abs=0.05)


def test_both_roads_prefer_the_same_noise() -> None:
    """The likeliest phi, off the spectrum and by the filter, within a third of its standard error, 0.016."""
    rng = np.random.default_rng(7)
    z = coloured((0.8,), 4000, rng) + rng.normal(size=4000)
    exact, spectral = exact_misfit([z]), spectral_misfit([z])
    innovation = ColouredNoise((0.8,), 1.0).innovation_variance

    phis = np.linspace(0.7, 0.9, 81)
    shapes = [Shape(1 / innovation, 1e-9, 1.0, (float(phi),)) for phi in phis]
    likeliest = [phis[int(np.argmin([misfit(shape)[0] for shape in shapes]))] for misfit in (exact, spectral)]
    assert abs(likeliest[0] - likeliest[1]) < 0.016 / 3
    assert likeliest[0] == pytest.approx(0.8, abs=0.06)


def test_the_unit_does_not_matter() -> None:
    rng = np.random.default_rng(8)
    z = coloured((0.9,), 5000, rng) + rng.normal(size=5000)
    found, other = fit_noise([z]), fit_noise([-1e-6 * z + 3e-3])
    assert found.coloured is not None
    assert other.coloured is not None
    assert other.white_variance == pytest.approx(1e-12 * found.white_variance, rel=1e-4)
    assert other.coloured.coefficients == pytest.approx(found.coloured.coefficients, rel=1e-4)


def test_a_steady_tone_is_a_narrow_resonance() -> None:
    found = fit_noise([np.random.default_rng(9).normal(size=20_000) + 0.5 * np.sin(0.9 * np.arange(20_000.0))])
    assert found.coloured is not None
    first, second = found.coloured.coefficients
    assert np.arccos(first / (2 * np.sqrt(-second))) == pytest.approx(0.9, rel=0.01)
    assert second < -0.99
    assert found.white_variance == pytest.approx(1.0, abs=0.04)


def test_equal_readings_have_no_noise_and_too_few_tell_none() -> None:
    assert fit_noise([np.full(100, 0.1), np.full(100, 1e6)]) == NoiseModel(0.0, None, 0.0, 200)
    with pytest.raises(
        RecordingError, match=r"^63 readings at rest came; 64 are needed to identify noise\. Name a longer rest"
    ):
        fit_noise([np.ones(63)])
    with pytest.raises(RecordingError, match=r"^0 readings"):
        fit_noise([])
    with pytest.raises(RecordingError, match=r"^No stretch at rest holds 64 readings"):
        fit_noise([np.arange(30.0), np.arange(40.0)])


def test_a_motion_is_not_this_rooms_business() -> None:
    """A motion of order 2 drifts: whatever is left white beside it is R."""
    rng, rows = np.random.default_rng(2), 5000
    model = motion(2, 1e-7).to_model(1.0, 1.0)
    x, truth, root = np.zeros(2), np.empty(rows), np.linalg.cholesky(model.process_covariance)
    for k in range(rows):
        truth[k], x = x[0], model.F @ x + root @ rng.normal(size=2)
    found = fit_noise([truth + rng.normal(size=rows)])
    assert found.coloured is None
    assert found.white_variance == pytest.approx(1.0, abs=0.15)
