"""What a channel keeps to is found from a record of it: rails, codes, and how long it holds one."""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.health.limits import Limits, find_limits, find_resolution, run_lengths, stuck_at_once
from becalm.core.health.outlier_rule import verdicts_from_neighbours
from becalm.core.health.saturation import SaturationLimits, find_saturation
from becalm.core.reading_verdicts import Verdict
from becalm.errors import UsageError
from becalm.files.inputs.opening import read
from becalm.native.scans import EVERY_REPEAT
from sensor_faults_records import DATA, REAL

ROWS = 20_000
T = np.arange(float(ROWS))


def noise(seed: int = 0) -> Floats:
    return np.random.default_rng(seed).normal(size=ROWS)


def even(count: int) -> Floats:
    elapsed = np.ones(count)
    elapsed[:1] = 0.0
    return elapsed


def limits_of(z: Floats) -> Limits:
    return find_limits(z, even(len(z)), 1.0, 0.002)


def held(count: int, ramp: int) -> Floats:
    """Ramps and holds of a channel that has no noise: six levels."""
    return np.concatenate([np.r_[np.full(count, 50.0 * k), np.linspace(50 * k, 50 * k + 50, ramp)] for k in range(6)])


@pytest.mark.parametrize("lsb", [0.2, 1.0, 3.0, 1e-6, 2.0**-20, 0.1])
def test_the_step_between_codes_is_found(lsb: float) -> None:
    z = 7.3 + lsb * np.round(30 * noise())
    assert find_resolution(z) == pytest.approx(lsb, rel=1e-6)
    digits = int(np.ceil(-np.log10(lsb))) + 6
    assert find_resolution(np.round(z, digits)) == pytest.approx(lsb, rel=1e-5)


def test_codes_of_which_no_neighbours_came_still_tell_their_step() -> None:
    assert find_resolution(0.25 * np.array([0.0, 6.0, 16.0, 31.0])) == pytest.approx(0.25)


@pytest.mark.parametrize("z", [noise(), np.cumsum(noise()), np.ones(50), np.empty(0), np.array([1.0, 2.0])])
def test_readings_on_no_lattice_have_no_resolution(z: Floats) -> None:
    assert find_resolution(z) == 0.0


def test_a_few_wild_readings_off_the_codes_hide_no_step() -> None:
    z = 0.25 * np.round(noise() / 0.25)
    z[[100, 200]] = 40.1, -17.3  # they lie on a finer lattice
    assert find_resolution(z) == 0.25
    z[::100] += 2.0 ** (np.arange(len(z[::100])) % 20) * 1.234567 + 1e-3 * noise(1)[::100]
    assert find_resolution(z) == 0.25
    assert find_resolution(noise()) == 0.0


def test_an_outlier_between_few_codes_does_not_hide_their_step() -> None:
    """Only three values repeat; the outlier lies on no code."""
    z = np.random.default_rng(1).choice([2.5, 5.0, 7.5], 500)
    z[100] = -10.3487910557
    assert find_resolution(z) == pytest.approx(2.5)


def test_runs_are_counted() -> None:
    assert run_lengths(np.array([1.0, 1, 2, 3, 3, 3])).tolist() == [2, 1, 3]
    assert run_lengths(np.empty(0)).tolist() == []


@pytest.mark.parametrize("lsb", [0.0, 0.2, 1.0, 3.0])
@pytest.mark.parametrize("seed", range(5))
def test_rails_that_clip_a_noisy_signal_are_found(lsb: float, seed: int) -> None:
    z = 100 * np.sin(T / 300) + noise(seed)
    z = np.clip(lsb * np.round(z / lsb) if lsb else z, -60.0, 81.0)
    assert find_saturation(z, lsb) == SaturationLimits(-60.0, 81.0)
    assert find_saturation(np.minimum(z, 60.0), lsb) == SaturationLimits(-60.0, 60.0)


NO_RAILS = {
    "constant": np.full(ROWS, 3.0),
    "white noise": noise(),
    "a handful of codes": np.round(noise()),
    "square wave without noise": np.sign(np.sin(T / 100)),
    "square wave": 40 * np.sign(np.sin(T / 100)) + noise(),
    "coarse square wave": 3 * np.round((40 * np.sign(np.sin(T / 100)) + noise()) / 3),
    "ramps and holds without noise": np.tile(held(500, 400), 4),
    "ramps and holds": held(500, 400) + noise()[:5400],
    "coarse ramps and holds": 3 * np.round((held(500, 400) + noise()[:5400]) / 3),
    "smooth peaks without noise": np.round(100 * np.sin(T / 300)),
    "peaks as long as the record": np.round(1000 * np.sin(T / 6000)),
    "standing, then driving": np.maximum(0.0, 30 * np.sin(T / 1000) + 0.1 * noise()),
    "random walk": np.round(np.cumsum(noise())),
    "few readings": np.array([1.0, 2.0, 3.0, 3.0]),
}


@pytest.mark.parametrize("name", NO_RAILS)
def test_what_a_signal_does_itself_is_no_rail(name: str) -> None:
    z = NO_RAILS[name]
    assert find_saturation(z, find_resolution(z)) == SaturationLimits()


def test_a_range_that_is_given_is_used_as_it_is() -> None:
    limits = find_limits(noise(), even(ROWS), 1.0, 0.002, (-50.0, 40.0))
    assert (limits.low, limits.high) == (-50.0, 40.0)


@pytest.mark.parametrize("sigma", [0.5, 1.0, 2.0, 5.0])
def test_the_longest_run_is_that_of_the_textbook_law(sigma: float) -> None:
    """p^n readings an hour = alarms an hour, p = LSB / (2 sqrt(pi) sigma); a margin of two above, and not of four."""
    n = np.log(3600 * 500) / -np.log(min(0.6, 1 / (2 * np.sqrt(np.pi) * sigma)))
    found = limits_of(np.round(sigma * noise() + 0.3)).stuck_readings
    assert found is not None
    assert n < found < 4 * n


@pytest.mark.parametrize("offset", [0.0, 0.25, 0.5])
def test_a_level_on_the_edge_of_a_code_tells_how_long_one_in_its_middle_stays(offset: float) -> None:
    worst = np.log(3600 * 500) / -np.log(0.8664)  # two normal quantiles of 1.5
    found = limits_of(np.round(noise() / 3 + offset)).stuck_readings
    assert found is not None
    assert found > worst


@pytest.mark.parametrize("lengths", [(3000,), (1200, 800), (500, 400, 300)])
@pytest.mark.parametrize("lsb", [0.0, 0.2, 1.0])
def test_stuck_stretches_of_the_record_itself_are_no_healthy_runs(lengths: tuple[int, ...], lsb: float) -> None:
    z = np.cumsum(noise(1)) + noise()
    z = lsb * np.round(z / lsb) if lsb else z
    healthy = limits_of(z).stuck_readings
    for k, length in enumerate(lengths):
        z[4000 * k + 1000 : 4000 * k + 1000 + length] = z[4000 * k + 1000]
    found = limits_of(z).stuck_readings
    assert healthy is not None
    assert found is not None
    assert found <= 2 * healthy < min(lengths)


@pytest.mark.parametrize("value", [0.0, 0.3])
def test_dropouts_that_share_a_value_are_no_rest(value: float) -> None:
    z = np.sin(T / 45) + 0.1 * noise()
    z[8000:8400] = z[12_000:14_000] = value
    limits = limits_of(z)
    assert limits.stuck_readings is not None
    assert limits.stuck_readings < 20
    codes = verdicts_from_neighbours(z, limits.outliers, stuck_at_once(limits))
    assert (codes[8000:8400] == Verdict.STUCK).all()
    assert (codes[12_000:14_000] == Verdict.STUCK).all()
    assert np.count_nonzero(codes) == 2400


CANNOT_TELL = {
    "constant": np.full(ROWS, 3.0),
    "two codes": np.round(noise() > 1.0).astype(float),
    "few readings": noise()[:30],
    "nothing": np.full(100, np.nan),
    "no readings": np.empty(0),
}


@pytest.mark.parametrize("name", CANNOT_TELL)
def test_a_record_that_cannot_tell_sets_no_limit(name: str) -> None:
    assert limits_of(CANNOT_TELL[name]).stuck_readings is None


def test_stops_of_a_car_are_no_faults() -> None:
    """Several stops at exactly 0, and a single one."""
    for period in (1000, 3500):
        z = np.maximum(0.0, 30 * np.sin(T / period + 0.3) + 0.1 * noise())
        found, longest = limits_of(z).stuck_readings, run_lengths(z).max()
        assert found is None or found > longest > 500


def test_late_rows_leave_time_even_and_polling_does_not() -> None:
    elapsed = even(ROWS)
    elapsed[500::1000], elapsed[501::1000] = 1.4, 0.6
    assert find_limits(noise(), elapsed, 1.0, 0.01).even
    elapsed = even(ROWS)
    elapsed[50::63] = 0.75
    assert not find_limits(noise(), elapsed, 1.0, 0.01).even
    events = np.random.default_rng(0).exponential(size=ROWS)
    limits = find_limits(noise(), events, 1.0, 0.01)
    assert not limits.even
    assert np.mean(events > limits.gap_steps) < 0.01


def test_limits_say_what_they_need() -> None:
    with pytest.raises(UsageError, match="above 0"):
        find_limits(noise(), even(ROWS), 0.0, 0.01)
    with pytest.raises(UsageError, match="above 0"):
        find_limits(noise(), even(ROWS), 1.0, float("nan"))
    with pytest.raises(UsageError, match="not a range"):
        find_limits(noise(), even(ROWS), 1.0, 0.01, (1.0, 1.0))


@pytest.mark.parametrize("file", REAL)
def test_no_healthy_channel_is_stuck_or_has_rails(file: str) -> None:
    """Twice what the record holds is far enough, and no limit would be as good as none."""
    if not (DATA / file).exists():
        pytest.skip(f"the recordings are not beside the project ({file})")
    recording = read(DATA / file, rate_hz=REAL[file])
    for name, z in zip(recording.names, recording.samples.T, strict=True):
        limits = find_limits(z, recording.timebase.elapsed_steps, 1.0, recording.timebase.step_s)
        assert limits.rails == SaturationLimits()
        if name.startswith("Magnetometer"):  # a new reading comes every five rows
            assert limits.stuck_readings == EVERY_REPEAT
            continue
        assert limits.stuck_readings is not None
        assert run_lengths(z[np.isfinite(z)]).max() < limits.stuck_readings < 50


def test_a_tracker_that_lost_sight_is_stuck() -> None:
    """Its positions were held where its quaternions are missing."""
    path = DATA / "broad" / "05_undisturbed_slow_rotation_with_breaks_B.hdf5"
    if not path.exists():
        pytest.skip(f"the recordings are not beside the project ({path.name})")
    import h5py

    with h5py.File(path) as file:
        position, lost = file["opt_pos"][:, 0], np.isnan(file["opt_quat"][:, 0])
    elapsed = even(len(position))
    limits = find_limits(position, elapsed, 1.0, 7 / 2000)
    assert limits.stuck_readings is not None
    assert limits.stuck_readings < 10
    assert lost.sum() > 1000
    same = np.append(False, np.diff(position) == 0)
    assert np.mean(lost[same]) > 0.99
