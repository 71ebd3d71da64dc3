"""The length of independence foretells the error of means of simulated walks; that of the noise passed does not."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.steady.response import describe
from becalm.identification.likelihood import Tuning
from becalm.identification.trust.tuning_spread import independence_steps
from becalm.identification.wishes.gain_of_waiting import waiting_curve
from walks import clean, draw

ROWS = 200_000


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize(("order", "ratio"), [(1, 0.02), (2, 1e-3)])
def test_means_err_as_it_says(order: int, ratio: float, causal: bool) -> None:
    truth, z = draw(order, ratio, ROWS, np.random.default_rng([order, 9]))
    tuning = Tuning(order, ratio, 1.0, ROWS)
    length = independence_steps(tuning, causal)
    assert length is not None
    signal, sigma = clean(tuning, z, causal)
    n = round(40 * length)
    blocks = ROWS // n
    means = (signal - truth)[: blocks * n].reshape(blocks, n).mean(axis=1)
    error = np.sqrt(np.mean(means**2))
    foretold = sigma[ROWS // 2] * np.sqrt(length / n)
    assert error == pytest.approx(foretold, rel=4 / np.sqrt(2 * blocks))
    if not causal:
        model = tuning.component.to_model(1.0, 1.0)
        of_noise = 1 / (2 * describe(model, 1.0, causal).noise_bandwidth_hz)
        beside = sigma[ROWS // 2] * np.sqrt(of_noise / n)
        assert abs(error / beside - 1) > 2 * abs(error / foretold - 1)


def test_of_order_one_it_is_that_of_a_decaying_correlation() -> None:
    ratio = 0.02
    K = (np.sqrt(ratio**2 + 4 * ratio) - ratio) / 2
    assert independence_steps(Tuning(1, ratio, 3.0, 0), causal=True) == pytest.approx((2 - K) / K)
    assert independence_steps(Tuning(1, 0.0, 3.0, 0), causal=True) is None


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_a_long_mean_of_smoothed_samples_is_as_good_as_that_of_readings(order: int) -> None:
    tuning = Tuning(order, 1e-4**order, 4.0, 0)
    length = independence_steps(tuning, causal=False)
    assert length is not None
    sigma = waiting_curve(order, tuning.ratio, 4.0, 1.0)[-1].sigma
    assert sigma**2 * length == pytest.approx(4.0, rel=1e-6)
