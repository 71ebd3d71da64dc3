"""What a converter's rounding leaves, against simulation."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.health.quantisation import converter_step, residual_std, rounding_left


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("step", [1.0, 0.057])
def test_the_error_that_no_average_lowers_is_as_simulated(noise: float, step: float) -> None:
    """Means of 20 000 readings each, of 1000 levels over a step."""
    rng = np.random.default_rng(0)
    levels = np.linspace(0, step, 1000, endpoint=False)
    errors = np.array(
        [np.mean(step * np.round((x + noise * step * rng.normal(size=20_000)) / step)) - x for x in levels]
    )
    assert residual_std(step, noise * step) == pytest.approx(float(errors.std()), rel=0.01)


def test_without_noise_it_is_that_of_rounding() -> None:
    assert residual_std(1.5, 0.0) == pytest.approx(1.5 / np.sqrt(12), rel=1e-3)
    assert residual_std(1.5, 1.5) < 1e-8
    assert residual_std(0.0, 0.1) == 0.0


def rounded(z: Floats, step: float) -> Floats:
    return step * np.round(z / step)


def test_motion_over_codes_leaves_less_than_rest() -> None:
    t, rng = np.arange(4000.0), np.random.default_rng(1)
    rest, moving = rounded(0.3 + 0.05 * rng.normal(size=4000), 1.0), rounded(0.37 * t, 1.0)
    assert rounding_left(rest + (t == 9) - (t == 99), 1 / 12, 10) == pytest.approx(1 / np.sqrt(12), rel=1e-3)
    assert rounding_left(moving, 1 / 12, 10) < 1e-3


def test_set_values_are_not_rounded_and_a_converter_is() -> None:
    rng = np.random.default_rng(2)
    assert converter_step(np.repeat(50.0 * rng.integers(0, 5, 40), 100)) == 0.0
    assert converter_step(rounded(rng.normal(size=4000), 0.5)) == pytest.approx(0.5)
    assert converter_step(rng.normal(size=4000)) == 0.0
    assert converter_step(rounded(20 + np.sin(np.arange(4000) / 500), 0.057)) == pytest.approx(0.057)
