"""The front foretells what filters leave and how late they are; a pick fulfils its wish; waiting gains."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import motion
from becalm.core.steady.dials import motion_filter
from becalm.errors import ModelError, UsageError
from becalm.identification.likelihood import Evidence, tune_motion
from becalm.identification.wishes.gain_of_waiting import waiting_curve
from becalm.identification.wishes.noise_against_lag import TradeOffCurve, pick, trade_off_curve

RATE_HZ = 500.0
R = 0.04  # unit^2


@pytest.fixture(scope="module")
def front() -> TradeOffCurve:
    return trade_off_curve(R, 1 / RATE_HZ)


def test_the_front_has_no_point_that_another_beats(front: TradeOffCurve) -> None:
    best = front.best
    assert front.orders == (1, 2, 3)
    for point in best:
        assert not any(p.lag_s < point.lag_s and p.noise_std < point.noise_std for p in front.points)
    left_out = [point for point in front.points if point not in best]
    assert left_out
    for point in left_out:
        assert any(p.lag_s <= point.lag_s and p.noise_std <= point.noise_std for p in best)
    assert all(a.lag_s < b.lag_s and a.noise_std > b.noise_std for a, b in pairwise(best))


def test_the_front_foretells_the_noise_of_a_recording() -> None:
    """The variance is identified, the noise left is foretold; then noise alone is filtered."""
    rng = np.random.default_rng(5)
    count, sd = 60_000, np.sqrt(R)
    noise = sd * rng.normal(size=count)
    walk = np.cumsum(0.02 * sd * rng.normal(size=count))
    elapsed = np.append(0.0, np.ones(count - 1))
    tuned = tune_motion(1, Evidence.of(walk + noise, elapsed))
    for point in trade_off_curve(tuned.noise_variance, 1 / RATE_HZ, (1, 2), (tuned.ratio, 0.05)).points:
        left = kalman_filter(motion(point.order, point.ratio).to_model(1.0, 1.0), noise).signal[2000:, 0]
        independent = 2 * point.noise_bandwidth_hz / RATE_HZ * len(left)
        assert left.std() == pytest.approx(point.noise_std, rel=4 / np.sqrt(2 * independent) + 0.02)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_point_is_the_filter_that_runs(front: TradeOffCurve, order: int) -> None:
    point = [point for point in front.points if point.order == order][30]
    z = np.zeros(40_000)
    z[20_000] = 1.0
    passed = kalman_filter(motion(order, point.ratio).to_model(1.0, 1.0), z).signal[20_000:, 0]
    assert np.sqrt(R * (passed @ passed)) == pytest.approx(point.noise_std, rel=1e-7)
    climbed = np.cumsum(passed)
    assert 100 * (climbed.max() - 1) == pytest.approx(point.overshoot_percent, rel=1e-5, abs=1e-5)
    i = int(np.argmax(climbed >= 0.9))
    crossed = i - 1 + (0.9 - climbed[i - 1]) / (climbed[i] - climbed[i - 1])
    assert (crossed + 0.1) / RATE_HZ == pytest.approx(point.step_90_s, rel=1e-6)
    assert point.noise_bandwidth_hz == pytest.approx(RATE_HZ / 2 * float(passed @ passed), rel=1e-7)


@pytest.mark.parametrize("wish", ["max_lag_s", "bandwidth_hz", "noise_gain_db"])
def test_a_pick_fulfils_its_wish_and_is_the_best_that_does(front: TradeOffCurve, wish: str) -> None:
    value, field = {
        "max_lag_s": (0.012, "lag_s"),
        "bandwidth_hz": (40.0, "bandwidth_hz"),
        "noise_gain_db": (-14.0, "noise_gain_db"),
    }[wish]
    picked = pick(front, **{wish: value})
    everyone = (picked.point, *picked.rivals)
    assert sorted(point.order for point in everyone) == [1, 2, 3]
    for point in everyone:
        assert getattr(point, field) == pytest.approx(value, rel=1e-8)
    judged = "lag_s" if wish == "noise_gain_db" else "noise_std"
    assert all(getattr(picked.point, judged) <= getattr(rival, judged) for rival in picked.rivals)
    assert f"With {wish} = {value:g}, order {picked.point.order} is the" in picked.why
    assert all(f"{point.noise_gain_db:.1f} dB" in picked.why for point in everyone)


def test_no_point_of_the_front_beats_a_pick(front: TradeOffCurve) -> None:
    picked = pick(front, max_lag_s=0.01).point
    quicker = [point for point in front.points if point.lag_s <= 0.01]
    assert quicker
    assert picked.noise_std <= min(point.noise_std for point in quicker)


def test_a_front_of_one_order_keeps_it() -> None:
    picked = pick(trade_off_curve(R, 1 / RATE_HZ, (3,), (0.1,)), max_lag_s=0.01)
    assert picked.point.order == 3
    assert picked.rivals == ()


# order: decibels after waiting 0.5, 1, 2 and 3 times 1 / cut-off, and for all
GAINS = {1: (1.6, 2.4, 2.9, 3.0, 3.01), 2: (2.9, 4.9, 5.8, 5.8, 6.02), 3: (4.1, 6.4, 6.9, 7.3, 7.78)}


@pytest.mark.parametrize("order", GAINS)
def test_waiting_gains_the_decibels_that_are_printed(order: int) -> None:
    """At a cut-off of 0.02 radians a step, as they were computed; the smoother's are of the limit."""
    cutoff = 0.02
    curve = waiting_curve(order, cutoff ** (2 * order), R, 1 / RATE_HZ, [0, 25, 50, 100, 150])
    assert [wait.wait_s * RATE_HZ for wait in curve] == pytest.approx([0, 25, 50, 100, 150, np.inf])
    assert [wait.gain_db for wait in curve[1:-1]] == pytest.approx(GAINS[order][:-1], abs=0.05)
    slow = waiting_curve(order, 1e-4 ** (2 * order), R, 1 / RATE_HZ, [0])[-1]
    assert slow.gain_db == pytest.approx(10 * np.log10(2 * order), abs=1e-3)
    assert slow.gain_db == pytest.approx(GAINS[order][-1], abs=0.01)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_the_curve_goes_from_the_filter_to_the_smoother(order: int) -> None:
    ratio = 0.1 ** (2 * order)
    curve = waiting_curve(order, ratio, R, 1 / RATE_HZ)
    model = motion(order, ratio * R).to_model(1.0, R)
    z = np.zeros(4001)
    assert curve[0].wait_s == 0.0
    assert curve[0].sigma == pytest.approx(kalman_filter(model, z).sigma[-1, 0], rel=1e-7)
    assert curve[-1].sigma == pytest.approx(kalman_smoother(model, z).sigma[2000, 0], rel=1e-7)
    sigmas = [wait.sigma for wait in curve]
    assert all(a >= b * (1 - 1e-12) for a, b in pairwise(sigmas))
    z[2000] = 1.0
    passed = kalman_smoother(model, z).signal[:, 0]
    assert curve[-1].noise_std == pytest.approx(np.sqrt(R * (passed @ passed)), rel=1e-6)
    assert curve[0].noise_std == pytest.approx(np.sqrt(R * motion_filter(order, ratio).noise_gain()), rel=1e-9)


def test_wishes_that_cannot_be_are_said(front: TradeOffCurve) -> None:
    with pytest.raises(UsageError, match="0 wishes came"):
        pick(front)
    with pytest.raises(UsageError, match="2 wishes came"):
        pick(front, max_lag_s=1.0, bandwidth_hz=1.0)
    with pytest.raises(UsageError, match="less than 250 Hz, half the rate") as caught:
        pick(front, bandwidth_hz=250.0)
    assert str(caught.value).count("half the rate") == 1
    with pytest.raises(UsageError, match="give noise_gain_db = -14"):
        pick(front, noise_gain_db=3.0)
    with pytest.raises(UsageError, match="noise_variance = -1"):
        trade_off_curve(-1.0, 0.01)
    with pytest.raises(UsageError, match="each q/r must be positive"):
        trade_off_curve(1.0, 0.01, (1,), (1.0, float("nan")))
    with pytest.raises(UsageError, match="needs an order"):
        trade_off_curve(1.0, 0.01, ())
    with pytest.raises(UsageError, match=r"^waits = \[-1\] contains a negative wait; .* 0 or more"):
        waiting_curve(1, 0.1, R, 0.01, [-1])
    with pytest.raises(UsageError, match=r"^ratio = 0 is not a q/r; give a positive number"):
        waiting_curve(1, 0, R, 0.01)
    for step_s in (-1.0, 0.0, float("nan")):
        with pytest.raises(ModelError, match=rf"^step_s = {step_s} is not a step; give a positive number of seconds"):
            waiting_curve(1, 0.1, R, step_s)
