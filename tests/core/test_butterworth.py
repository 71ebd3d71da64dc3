"""The Butterworth filter that is matched to a tuned filter is the one that is drawn elsewhere, and follows best."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, group_delay, sosfilt, sosfreqz

from becalm.core.closed_forms import butterworth_noise_gain, butterworth_response
from becalm.core.filter.filtering import kalman_filter
from becalm.core.model.components import motion
from becalm.core.model.model import Model
from becalm.core.steady.dials import ratio_for_bandwidth
from becalm.core.steady.response import describe

ORDERS = [1, 2, 3, 4, 5]


def model_of(order: int, ratio: float) -> Model:
    return motion(order, ratio).to_model(1.0, 1.0)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("cutoff", [0.004, 0.1, 0.4])
def test_a_butterworth_is_the_one_that_is_drawn(order: int, cutoff: float) -> None:
    f = np.linspace(1e-4, 0.499, 300)
    _, expected = sosfreqz(butter(order, 2 * cutoff, output="sos"), 2 * np.pi * f)
    np.testing.assert_allclose(butterworth_response(order, cutoff, f), expected, rtol=1e-6, atol=1e-12)


def test_the_matched_butterworth_follows_best() -> None:
    told = describe(model_of(2, 0.3**4), 1e-3)
    matched = told.butterworth
    assert matched is not None
    assert matched.cutoff_hz == told.bandwidth_hz
    impulse = np.append(1.0, np.zeros(4000))
    own = kalman_filter(model_of(2, 0.3**4), np.append(np.zeros(4000), impulse)).signal[4000:, 0]
    missed = {}
    for order in range(1, 7):
        passed = sosfilt(butter(order, 2e-3 * told.bandwidth_hz, output="sos"), impulse)
        missed[order] = ((own - passed) ** 2).sum()
        if order == matched.order:
            assert matched.noise_gain == pytest.approx((passed**2).sum(), rel=1e-6)
    assert matched.order == min(missed, key=lambda order: missed[order])
    _, delay = group_delay(butter(matched.order, 2e-3 * told.bandwidth_hz), [1e-6])
    assert matched.delay_s == pytest.approx(1e-3 * delay[0], rel=1e-6)
    assert f"matched Butterworth: order {matched.order}, {told.bandwidth_hz:.3g} Hz" in str(told)
    assert f"a {told.bandwidth_hz:.3g} Hz low-pass with" in str(told)


@pytest.mark.parametrize("order", range(1, 7))
@pytest.mark.parametrize("cutoff", [1e-5, 0.02, 0.25, 0.3, 0.49, 0.4999999])
def test_a_butterworth_leaves_what_its_response_passes(order: int, cutoff: float) -> None:
    """Up to half the rate, without a warning; the power is summed where the response bends."""
    f = np.arctan(np.tan(np.pi * cutoff) * np.geomspace(1e-7, 1e7, 200_001)) / np.pi
    f = np.concatenate([[0.0], f, [0.5 - 1e-16]])
    passed = np.abs(butterworth_response(order, cutoff, f)) ** 2
    assert butterworth_noise_gain(order, cutoff) == pytest.approx(2 * np.trapezoid(passed, f), rel=1e-6)


@pytest.mark.parametrize("order", ORDERS)
def test_a_filter_that_passes_nearly_all_is_described_without_a_warning(order: int) -> None:
    told = describe(model_of(order, ratio_for_bandwidth(order, 49.9999, 0.01)), 0.01)
    assert told.butterworth is not None
    assert 0.99 < told.butterworth.noise_gain < 1
