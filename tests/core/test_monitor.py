"""Innovations that are no longer white noise of variance 1: told in time, and hardly ever without cause."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, poisson

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.health.monitor import SLACK, InnovationMonitor, cusum_delay, cusum_threshold, find_alarms
from becalm.core.model.model import Model
from becalm.core.reading_verdicts import Verdict
from becalm.errors import UsageError
from becalm.native.scans import HOP, WINDOW

STEP_S = 0.002
ALARMS = find_alarms(1.0, STEP_S)


def noise(count: int, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).normal(size=count)


def page_loop(x: Floats, threshold: float) -> list[int]:
    """Page's recursion as it is written, on the sixteen bits of a sigma that the monitor counts."""
    alarms, total = [], 0.0
    for i, each in enumerate(np.rint(x * 65536) / 65536):
        total = max(0.0, total + each - SLACK)
        if total >= np.ceil(threshold * 65536) / 65536:
            alarms.append(i)
            total = 0.0
    return alarms


def test_the_sum_is_the_textbook_recursion() -> None:
    x = np.clip(noise(30_000) + np.repeat([0.0, 0.8, 0.0], 10_000), -6, 6)
    alarms = ALARMS._replace(drift_threshold=5.0)
    told = np.flatnonzero(InnovationMonitor(alarms).push(x) == Verdict.DRIFT).tolist()
    assert len(page_loop(x, 5.0)) > 100
    assert told == sorted({*page_loop(x, 5.0), *page_loop(-x, 5.0)})


@pytest.mark.parametrize("readings", [500, 2000, 10_000])
def test_false_alarms_of_drift_are_as_rare_as_asked(readings: int) -> None:
    """Siegmund's approximation, by counting some 400 alarms; two sides together."""
    alarms = ALARMS._replace(drift_threshold=cusum_threshold(readings))
    count = int((InnovationMonitor(alarms).push(noise(400 * readings)) == Verdict.DRIFT).sum())
    assert poisson.ppf(0.001, 400) * 0.95 <= count <= poisson.ppf(0.999, 400) * 1.05


def test_the_threshold_and_the_delay_are_of_one_law() -> None:
    for readings in (100, 1e4, 1e8):
        assert cusum_delay(cusum_threshold(readings), 0.0) == pytest.approx(2 * readings, rel=1e-9)
    assert cusum_delay(8.0, SLACK) == pytest.approx(cusum_delay(8.0, SLACK + 1e-4), rel=1e-2)


@pytest.mark.parametrize("per_hour", [1.0, 1e-20, 1e-60, 1e-90])
def test_a_dead_window_is_judged_by_chi_square_and_is_far_below_what_is_expected(per_hour: float) -> None:
    per_window = per_hour * HOP / (3 * 3600 / STEP_S)
    chance = chi2.ppf(per_window, WINDOW - 1) / (WINDOW - 1)
    assert find_alarms(per_hour, STEP_S).dead_variance == pytest.approx(min(0.05, chance), rel=1e-6)


@pytest.mark.parametrize("shift", [1.0, -1.0])
def test_a_shift_of_one_sigma_is_told_after_the_stated_delay(shift: float) -> None:
    delays, began = [], []
    for seed in range(200):
        monitor = InnovationMonitor(ALARMS)
        monitor.push(noise(2000, seed) + shift * (np.arange(2000) >= 1000))
        delays.append(monitor.found[Verdict.DRIFT].first_row - 999)
        assert monitor.drift_since is not None
        began.append(monitor.drift_since - 1000)
    assert np.mean(delays) == pytest.approx(ALARMS.drift_delay, rel=0.1)
    assert abs(np.median(began)) <= 3


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [500, 10_000])
def test_white_innovations_raise_no_more_alarms_than_asked(rate_hz: int) -> None:
    """Sixty an hour of all kinds, each kind a third."""
    monitor, rng = InnovationMonitor(find_alarms(60.0, 1 / rate_hz)), np.random.default_rng(rate_hz)
    hours = 20 if rate_hz == 500 else 2
    drift = dead = 0
    for _ in range(36 * hours):
        codes = monitor.push(rng.normal(size=100 * rate_hz))
        drift += int((codes == Verdict.DRIFT).sum())
        dead += int((codes == Verdict.DEAD).sum())
    assert drift <= poisson.ppf(0.999, 20 * hours)
    assert dead == 0


@pytest.mark.parametrize("ratio", [1e-4, 0.01, 1.0])
def test_a_dead_sensor_behind_a_filter_is_told_within_the_stated_delay(ratio: float) -> None:
    """It gives one value; the filter needs a few of its time constants to be at rest there."""
    one = np.ones((1, 1))
    settling = 5 / np.sqrt(ratio)
    for seed in range(10):
        z = np.cumsum(np.sqrt(ratio) * noise(8000, seed + 100)) + noise(8000, seed)
        z[6000:] = z[6000]
        filtered = kalman_filter(Model(F=one, H=one, Q=ratio * one, R=one, x0=[0.0], P0=one), z)
        codes = InnovationMonitor(ALARMS).push((filtered.innovations / filtered.innovation_sigma)[:, 0])
        dead = np.flatnonzero(codes == Verdict.DEAD)
        assert 6000 <= dead[0] < 6000 + ALARMS.dead_delay + settling
        assert (codes[int(6000 + ALARMS.dead_delay + settling) :] == Verdict.DEAD).all()


def test_a_sensor_at_rest_is_not_dead() -> None:
    codes = InnovationMonitor(ALARMS).push(np.concatenate([noise(3000), 0.4 * noise(3000)]))
    assert (codes != Verdict.DEAD).all()


def test_a_rest_that_a_healthy_record_has_is_not_dead_and_no_noise_at_all_is() -> None:
    rests = noise(20_000) * np.repeat([1.0, 0.05, 1.0, 0.05], 5000)
    alarms = find_alarms(1.0, STEP_S, rests[:10_000])
    assert Verdict.DEAD in InnovationMonitor(find_alarms(1.0, STEP_S)).push(rests)
    monitor = InnovationMonitor(alarms)
    assert Verdict.DEAD not in monitor.push(rests)
    dead = np.flatnonzero(monitor.push(np.zeros(200)) == Verdict.DEAD)
    assert dead[0] < alarms.dead_delay
    assert find_alarms(1.0, STEP_S, np.zeros(200)).dead_variance == 0.0


@pytest.mark.parametrize("size", [20.0, 1e300, np.inf])
def test_single_spikes_are_no_drift_and_no_death(size: float) -> None:
    x = noise(50_000)
    x[::1000] = size
    assert (InnovationMonitor(ALARMS).push(x) == Verdict.USED).all()


def test_a_filter_that_follows_drift_hides_it_and_a_level_known_at_rest_shows_it() -> None:
    """A strain gauge that drifts by 0.1 sigma a second."""
    one, rows = np.ones((1, 1)), 30_000
    z = 0.1 * STEP_S * np.arange(rows) + noise(rows)
    filtered = kalman_filter(Model(F=one, H=one, Q=0.01 * one, R=one, x0=[0.0], P0=one), z)
    following, known = InnovationMonitor(ALARMS), InnovationMonitor(ALARMS)
    following.push((filtered.innovations / filtered.innovation_sigma)[:, 0])
    known.push(z)
    assert Verdict.DRIFT not in following.found
    assert known.found[Verdict.DRIFT].first_row * STEP_S * 0.1 < 1.0  # before it has drifted by one sigma


VALUES = st.sampled_from([0.0, 0.1, 1.0, -1.0, 3.0, -3.0, np.nan, np.inf, -np.inf, 1e300, -1e300]) | st.floats()
SENSITIVE = ALARMS._replace(drift_threshold=2.0)


@settings(max_examples=200)
@given(
    odd=st.lists(st.tuples(st.integers(0, 2999), VALUES), max_size=40),
    cuts=st.lists(st.integers(0, 3000), max_size=8).map(sorted),
)
def test_any_cuts_give_the_same_codes_and_the_same_finds(odd: list[tuple[int, float]], cuts: list[int]) -> None:
    x, elapsed = noise(3000) * np.repeat([1.0, 3.0, 0.01], 1000), 1.0 + noise(3000, 1) ** 2
    for row, value in odd:
        x[row] = value
    whole, cut = InnovationMonitor(SENSITIVE), InnovationMonitor(SENSITIVE)
    parts = [cut.push(*pair) for pair in zip(np.split(x, cuts), np.split(elapsed, cuts), strict=True)]
    assert np.array_equal(np.concatenate(parts), whole.push(x, elapsed))
    assert (cut.found, cut.drift_since) == (whole.found, whole.drift_since)
    assert cut.history.change() == whole.history.change()
    assert Verdict.DEAD in whole.found


def test_alarms_say_what_they_need() -> None:
    with pytest.raises(UsageError, match="above 0"):
        find_alarms(0.0, STEP_S)
    with pytest.raises(UsageError, match="above 0"):
        find_alarms(1.0, float("inf"))


def test_noise_that_all_but_ends_is_told() -> None:
    monitor = InnovationMonitor(ALARMS)
    monitor.push(np.where(np.arange(9600) < 6400, 3.0, 1e-10) * noise(9600))
    change = monitor.history.change()
    assert change is not None
    assert change.step == 6400
    assert change.ratio == pytest.approx(1e-10 / 3, rel=0.1)


@pytest.mark.parametrize("lost", [0, 1000])
def test_noise_that_changed_across_a_gap_is_another_from_its_end_on(lost: int) -> None:
    """Not from its beginning, hours before: whether rows are lost, or come without a reading."""
    x, elapsed = noise(4096) * np.repeat([1.0, 3.0], 2048), np.ones(4096 + lost)
    x = np.insert(x, 2048, np.full(lost, np.nan))
    elapsed[2048] = 1e6
    whole, cut = InnovationMonitor(ALARMS), InnovationMonitor(ALARMS)
    whole.push(x, elapsed)
    for pair in zip(np.array_split(x, 300), np.array_split(elapsed, 300), strict=True):
        cut.push(*pair)
    change = whole.history.change()
    assert change is not None
    assert change.step == 2047 + 1e6 + lost
    assert cut.history.change() == change


@pytest.mark.parametrize("threshold", [1e15, np.inf])
def test_a_threshold_that_nothing_reaches_tells_no_drift(threshold: float) -> None:
    codes = InnovationMonitor(ALARMS._replace(drift_threshold=threshold)).push(noise(200) + 5.0)
    assert (codes != Verdict.DRIFT).all()


def test_steps_of_other_rows_are_refused() -> None:
    with pytest.raises(UsageError, match="5 elapsed steps came with 100 rows"):
        InnovationMonitor(ALARMS).push(noise(100), np.ones(5))


@pytest.mark.parametrize(("odd", "usual"), [(np.nan, 1.0), (np.inf, float(1 << 31)), (-3.0, 0.0)])
def test_a_step_that_no_clock_gives_leaves_a_state_that_can_be_restored(odd: float, usual: float) -> None:
    one, other = InnovationMonitor(ALARMS), InnovationMonitor(ALARMS)
    rows = np.arange(100)
    one.push(noise(100), np.where(rows == 61, odd, 1.0))
    other.push(noise(100), np.where(rows == 61, usual, 1.0))
    restored = InnovationMonitor(ALARMS)
    restored.load_state_dict(one.state_dict())
    assert restored.state_dict()["monitor_state"].tobytes() == other.state_dict()["monitor_state"].tobytes()
