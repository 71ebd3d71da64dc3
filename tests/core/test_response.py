"""What is told of a filter is what the filter does: driven with sines, steps and noise; and the dials hold."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from becalm.core.arrays import Floats
from becalm.core.closed_forms import order_one
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import gauss_markov, level, motion, oscillator
from becalm.core.model.model import Model
from becalm.core.steady.dials import motion_filter, ratio_for_bandwidth, ratio_for_lag, ratio_for_noise_gain
from becalm.core.steady.response import describe, lag_steps
from becalm.core.steady.steady_filter import steady
from becalm.errors import ModelError, UsageError
from tracking_gains import alpha_beta, alpha_beta_continuous, alpha_beta_gamma, continuous_motion

ORDERS = [1, 2, 3, 4, 5]
COUNT = 20_000


def model_of(order: int, ratio: float) -> Model:
    return motion(order, ratio).to_model(1.0, 1.0)


def heard_power(model: Model, cycles: float) -> float:
    """Power of a unit sine after the running filter, once its start is forgotten."""
    turn = 2 * np.pi * cycles * np.arange(COUNT)
    signal = kalman_filter(model, np.sin(turn), sigma=False, innovations=False).signal[COUNT // 2 :, 0]
    waves = np.column_stack([np.sin(turn), np.cos(turn)])[COUNT // 2 :]
    return float((np.linalg.lstsq(waves, signal, rcond=None)[0] ** 2).sum())


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("rate_hz", [85.0, 100.0, 200.0, 1000.0, 5000.0])
def test_a_filter_made_for_forty_hertz_has_forty_hertz(order: int, rate_hz: float) -> None:
    """From 0.8 % to 47 % of the rate, driven with sines."""
    model = model_of(order, ratio_for_bandwidth(order, 40.0, 1 / rate_hz))
    heard = brentq(lambda f: heard_power(model, f / rate_hz) - 0.5, 39.0, 41.0, xtol=1e-4)
    assert heard == pytest.approx(40.0, rel=0.001)
    assert describe(model, 1 / rate_hz).bandwidth_hz == pytest.approx(40.0, rel=1e-9)


def climb(model: Model) -> Floats:
    """The running filter's step response, long after its start; the reading before the step comes first."""
    z = np.repeat([0.0, 1.0], COUNT)
    climbed: Floats = kalman_filter(model, z, sigma=False, innovations=False).signal[COUNT - 1 :, 0]
    return climbed


def crossing(line: Floats, height: float) -> float:
    """When a line through readings first reaches a height, in steps after the first reading."""
    i = int(np.argmax(line >= height))
    return float(i - 1 + (height - line[i - 1]) / (line[i] - line[i - 1]))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("cutoff", [0.02, 0.3, 1.5])
def test_a_step_is_followed_as_told(order: int, cutoff: float) -> None:
    model, step_s = model_of(order, cutoff ** (2 * order)), 0.01
    told, line = describe(model, step_s).step, climb(model)
    drawn = np.append(0.0, np.ones(COUNT))
    assert told is not None
    for height, delay_s in ((0.5, told.delay_50_s), (0.9, told.delay_90_s)):
        assert crossing(line, height) - crossing(drawn, height) == pytest.approx(delay_s / step_s, rel=1e-6, abs=1e-9)
    assert 100 * (line.max() - 1) == pytest.approx(told.overshoot_percent, rel=1e-6, abs=1e-6)
    last_outside = int(np.flatnonzero(np.abs(line - 1) > 0.02)[-1])
    assert told.settling_s / step_s == pytest.approx(last_outside, abs=1e-9)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("lag_s", [0.0004, 0.005, 0.05])
def test_the_dial_for_lag_holds_for_a_ramp_and_for_an_edge(order: int, lag_s: float) -> None:
    rate_hz = 1000.0
    model = model_of(order, ratio_for_lag(order, lag_s, 1 / rate_hz))
    ramp = np.arange(COUNT) / rate_hz
    behind_ramp = float(ramp[-1] - kalman_filter(model, ramp).signal[-1, 0])
    behind_edge = (crossing(climb(model), 0.5) - 0.5) / rate_hz
    assert max(behind_ramp, behind_edge) == pytest.approx(lag_s, rel=1e-6)
    assert describe(model, 1 / rate_hz).lag_s == pytest.approx(lag_s, rel=1e-9)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("decibel", [-0.5, -6.0, -20.0])
def test_the_dial_for_noise_holds_for_the_impulse_response(order: int, decibel: float) -> None:
    model = model_of(order, ratio_for_noise_gain(order, decibel))
    z = np.zeros(2 * COUNT)
    z[COUNT] = 1.0
    passed = kalman_filter(model, z).signal[COUNT:, 0]
    assert 10 * np.log10(passed @ passed) == pytest.approx(decibel, rel=1e-6)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("bound", [1e-4, 3e-4])
def test_the_slowest_filters_are_those_of_the_continuous_limit(order: int, bound: float) -> None:
    """Each figure differs from its limit by about the cut-off itself."""
    limit, found = continuous_motion(order), motion_filter(order, bound ** (2 * order))
    assert found.noise_gain() == pytest.approx(2 * limit.noise_bandwidth_hz * bound, rel=5 * bound)
    assert found.error_variance() == pytest.approx(limit.filtered_variance * bound, rel=5 * bound)
    assert found.error_variance(np.inf) == pytest.approx(limit.smoothed_variance * bound, rel=5 * bound)
    height = float(limit.step(np.array([lag_steps(found) * bound]))[0])
    assert height == pytest.approx(0.5 if order > 1 else 1 - np.exp(-1), rel=5 * bound)
    assert found.filter_power([3 * bound / (2 * np.pi)])[0] == pytest.approx(limit.power(np.array([3.0]))[0], rel=1e-3)


@pytest.mark.parametrize(("order", "overshoot", "peak_db"), [(1, 0.0, 0.0), (2, 20.8, 2.09), (3, 30.9, 3.99)])
def test_overshoot_and_peaking_of_the_limit_are_as_printed(order: int, overshoot: float, peak_db: float) -> None:
    limit = continuous_motion(order)
    assert 100 * (limit.step(np.linspace(0, 30, 30_001)).max() - 1) == pytest.approx(overshoot, abs=0.05)
    peak = limit.power(np.linspace(1e-3, 9, 30_001)).max()
    assert 10 * np.log10(peak) == pytest.approx(peak_db, abs=0.005)
    told = describe(model_of(order, 0.01 ** (2 * order)), 1.0)
    assert told.step is not None
    assert told.step.overshoot_percent == pytest.approx(overshoot, rel=0.02, abs=1e-9)
    assert told.peak_db == pytest.approx(peak_db, rel=0.02, abs=1e-9)


@pytest.mark.parametrize("ratio", [1e-6, 1e-3, 0.1, 2.0])
def test_order_one_is_its_closed_form(ratio: float) -> None:
    closed, found = order_one(ratio), steady(Model(F=[[1]], H=[[1]], Q=[[ratio]], R=[[1]]))
    got = [found.gain[0, 0], found.error_variance(), found.predicted_cov[0, 0], found.innovation_variance]
    got += [found.noise_gain(), lag_steps(found), describe(found.model, 1.0).bandwidth_hz]
    np.testing.assert_allclose(got, closed, rtol=1e-10)
    assert ratio_for_bandwidth(1, closed.bandwidth, 1.0) == pytest.approx(ratio, rel=1e-10)
    assert ratio_for_lag(1, closed.delay_steps, 1.0) == pytest.approx(ratio, rel=1e-10)
    assert ratio_for_noise_gain(1, 10 * np.log10(closed.noise_gain)) == pytest.approx(ratio, rel=1e-10)


@pytest.mark.parametrize("index", [1e-3, 0.05, 0.5, 3.0])
def test_alpha_beta_and_gamma_are_their_closed_forms(index: float) -> None:
    slope = Model(F=[[1, 1], [0, 1]], H=[[1, 0]], G=[[0.5], [1.0]], Q=[[index**2]], R=[[1]])
    closed, found = alpha_beta(index), steady(slope)
    np.testing.assert_allclose(found.gain[:, 0], closed, rtol=1e-10)
    assert found.error_variance() == pytest.approx(closed.filtered_cov[0, 0], rel=1e-10)
    assert found.noise_gain() == pytest.approx(closed.noise_gain, rel=1e-10)
    np.testing.assert_allclose(motion_filter(2, index**2).gain[:, 0], alpha_beta_continuous(index**2), rtol=1e-9)
    F = [[1, 1, 0.5], [0, 1, 1.0], [0, 0, 1.0]]
    three = steady(Model(F=F, H=[[1, 0, 0]], G=[[0.5], [1.0], [1.0]], Q=[[index**2]], R=[[1]]))
    np.testing.assert_allclose(three.gain[:, 0] * [1, 1, 2], alpha_beta_gamma(index), rtol=1e-9)
    assert three.noise_gain() == pytest.approx(alpha_beta_gamma(index).noise_gain, rel=1e-9)


def test_closed_forms_are_as_printed() -> None:
    printed = {1e-3: (0.0437352, 0.000977888), 0.05: (0.270867, 0.0426946)}
    printed |= {0.5: (0.628373, 0.304806), 3: (0.901492, 0.941578)}
    for index, gains in printed.items():
        np.testing.assert_allclose(alpha_beta(index), gains, rtol=2e-6)
    np.testing.assert_allclose(alpha_beta_continuous(0.25), (0.632085, 0.303280), rtol=2e-6)
    np.testing.assert_allclose(alpha_beta_gamma(0.05), (0.521351, 0.189919, 0.0691845), rtol=2.5e-6)
    three = alpha_beta_gamma(0.05)
    assert three.noise_gain == pytest.approx(0.462580, abs=5e-7)
    assert three._replace(gamma=2 * three.gamma).noise_gain == pytest.approx(three.alpha, rel=1e-9)  # the trap


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("wait", [0, 1, 7, 40])
def test_a_fixed_lag_leaves_what_is_told(order: int, wait: int) -> None:
    """Against the smoother of records that end so many readings later."""
    count, model = 300, model_of(order, 0.2 ** (2 * order))
    row = count - 1 - wait
    weights = np.array([kalman_smoother(model, impulse).signal[row, 0] for impulse in np.eye(count)])
    found = steady(model)
    assert found.noise_gain(wait) == pytest.approx(float(weights @ weights), rel=1e-7)
    assert found.error_variance(wait) == pytest.approx(kalman_smoother(model, np.zeros(count)).sigma[row, 0] ** 2, 1e-9)
    assert found.noise_gain(10**6) == pytest.approx(found.noise_gain(np.inf), rel=1e-9)


def test_components_are_described_one_by_one() -> None:
    model = (motion(2, 1e2) + oscillator(50.0, 0.5, 10.0)).to_model(1e-3, 1.0)
    f = np.linspace(1e-3, 0.5, 400)
    slow, tone, both = steady(model, [1, 0, 0, 0]), steady(model, [0, 0, 1, 0]), steady(model)
    np.testing.assert_allclose(slow.filter_response(f) + tone.filter_response(f), both.filter_response(f), atol=1e-10)
    smoothed = slow.smoother_response(f) + tone.smoother_response(f)
    np.testing.assert_allclose(smoothed, both.smoother_response(f), atol=1e-10)
    z = np.zeros(20_001)
    z[10_000] = 1.0
    states = kalman_filter(model, z, states=True, sigma=False).mean
    assert states is not None
    states = states[10_000:]
    assert slow.noise_gain() == pytest.approx(float((states[:, 0] ** 2).sum()), rel=1e-6)
    assert tone.noise_gain() == pytest.approx(float((states[:, 2] ** 2).sum()), rel=1e-6)
    told = describe(model, 1e-3, output=[0, 0, 1, 0])
    assert told.bands_hz[0][0] < 50 < told.bands_hz[-1][1]
    assert np.isnan(told.lag_s)
    assert str(told).startswith("a band-pass from")
    assert describe(model, 1e-3, output=[1, 0, 0, 0]).step is not None


def test_a_state_that_is_never_seen_changes_nothing() -> None:
    T, q, r = 1e-4, 1.3e-11, 5.8e-13
    paper = Model(F=[[1.0, T], [0.0, 1.0]], H=[[0, 1]], G=T * np.eye(2), Q=q * np.eye(2), R=[[r]])
    alone = describe(Model(F=[[1]], H=[[1]], Q=[[T**2 * q]], R=[[r]]), T)
    told = describe(paper, T)
    assert (told.bandwidth_hz, told.lag_s, told.noise_gain) == pytest.approx(
        (alone.bandwidth_hz, alone.lag_s, alone.noise_gain), rel=1e-9
    )
    assert describe(Model(F=[[2, 0], [0, 1]], H=[[0, 1]], Q=np.eye(2), R=[[1]]), 1.0).lag_s > 0
    with pytest.raises(ModelError, match="no reading determines"):
        describe(paper, T, output=[1, 0])


def test_the_lag_beside_a_tone_is_that_of_an_edge_that_has_arrived() -> None:
    """A wide tone takes most of an edge at once, rings, and leaves the motion a small, late rest."""
    model = (motion(1, 0.01**2) + oscillator(0.02, 0.01, 0.01)).to_model(1.0, 1.0)
    told, line = describe(model, 1.0), climb(model)
    last = int(np.flatnonzero(line < 0.5)[-1])
    crossed = last + (0.5 - line[last]) / (line[last + 1] - line[last]) - 0.5
    assert told.lag_s == pytest.approx(crossed, rel=1e-6)
    assert told.step is not None
    assert told.step.delay_50_s < told.lag_s
    ramp = np.arange(float(COUNT))
    behind_ramp = float(ramp[-1] - kalman_filter(model, ramp).signal[-1, 0])
    assert told.dc_delay_s == pytest.approx(behind_ramp, rel=1e-6)


def test_what_a_model_lets_fade_is_told() -> None:
    told = describe(gauss_markov(0.1, 0.1).to_model(0.01, 1.0), 0.01)
    model = gauss_markov(0.1, 0.1).to_model(0.01, 1.0)
    assert kalman_filter(model, np.ones(COUNT)).signal[-1, 0] == pytest.approx(told.dc_gain, rel=1e-9)
    assert f"gain {told.dc_gain:.2g} at 0 Hz" in str(told)


def test_a_sine_comes_no_later_than_told() -> None:
    model = model_of(2, 0.1**4)
    told = describe(model, 1.0)
    f = np.linspace(1e-4, told.bandwidth_hz, 2000)
    late = -np.unwrap(np.angle(steady(model).filter_response(f))) / (2 * np.pi * f)
    assert late.max() == pytest.approx(told.sine_delay_s, rel=1e-4)
    assert told.sine_delay_s > told.lag_s


def test_what_is_impossible_is_said_with_what_is_possible() -> None:
    for order in ORDERS:
        with pytest.raises(UsageError, match="less than 50 Hz, half the rate"):
            ratio_for_bandwidth(order, 50.0, 0.01)
        with pytest.raises(UsageError, match=rf"order {order}; ask for .* to "):
            ratio_for_noise_gain(order, -180.0)
        with pytest.raises(UsageError, match=rf"order {order}; ask for .* to "):
            ratio_for_lag(order, 1e9, 0.01)
        with pytest.raises(UsageError, match="give noise_gain_db = -14"):
            ratio_for_noise_gain(order, 14.0)
        with pytest.raises(UsageError, match="give a positive number of seconds"):
            ratio_for_lag(order, 0.0, 0.01)
    with pytest.raises(ModelError, match="order = 6 is not offered"):
        ratio_for_lag(6, 1.0, 0.01)
    with pytest.raises(ModelError, match="Give that state a positive Q"):
        describe(level(0.0).to_model(1.0, 1.0), 1.0)
    with pytest.raises(ModelError, match="step_s = 0"):
        describe(level(1.0).to_model(1.0, 1.0), 0)
    with pytest.raises(ModelError, match="H is 0"):
        describe(Model(F=[[1]], H=[[0]], Q=[[1]], R=[[1]]), 1.0)
