"""A real accelerometer laid down in some forty poses: gravity becomes as long in all of them."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import pytest

from becalm.cleaning.sensor_files.pose_calibration import find_poses, find_rests
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.errors import SensorError
from becalm.sensors.poses import Rests, calibrate_by_length, common_factor

DATA = Path(__file__).parents[2].parent / "shared" / "data"
MID_SCALE = np.full(3, 32_768.0)  # of 16 bits: the zero by the sheet
FEWER = 5  # times


@functools.cache
def laid_down() -> Recording:
    path = DATA / "imu_tk" / "xsens_acc.mat.txt.gz"
    if not path.exists():
        pytest.skip(f"{path} is not here")
    columns = np.loadtxt(path)
    return Recording(columns[:, 1:], times_s=columns[:, 0], names=["x", "y", "z"], units=["counts"] * 3)


@functools.cache
def rests() -> Rests:
    return find_rests(laid_down())


def sphere(means: Floats) -> Floats:
    """Return the zero (3,) that suits one common factor best: the centre of the nearest sphere."""
    return np.asarray(np.linalg.lstsq(np.column_stack([2 * means, np.ones(len(means))]), (means**2).sum(1))[0][:3])


def test_gravity_becomes_as_long_in_all_poses() -> None:
    means = rests().means
    after = calibrate_by_length(find_poses(laid_down())).spread(means)
    assert FEWER * after < common_factor(means, sphere(means)).spread(means)
    assert 100 * after < common_factor(means, MID_SCALE).spread(means)


@pytest.mark.parametrize("first", [0, 1])
def test_gravity_becomes_as_long_in_poses_that_were_held_out(first: int) -> None:
    means, stds = rests()
    found, out = calibrate_by_length(Rests(means[first::2], stds[first::2])), means[1 - first :: 2]
    assert FEWER * found.spread(out) < common_factor(means[first::2], sphere(means[first::2])).spread(out)


def test_errors_are_small_and_told() -> None:
    found = calibrate_by_length(find_poses(laid_down()))
    assert (found.bias_std < 1.0).all()  # of 4000 counts for g
    halves = [calibrate_by_length(Rests(*(part[first::2] for part in rests()))) for first in (0, 1)]
    apart = np.abs(halves[0].bias - halves[1].bias) / np.hypot(halves[0].bias_std, halves[1].bias_std)
    assert (apart < 4).all()


def test_a_record_with_few_rests_says_how_many() -> None:
    noise = np.random.default_rng(0).normal([0.0, 0.0, 9.8], 1.0, (3000, 3))
    with pytest.raises(SensorError, match="1 rests were found, but 10 are needed"):
        find_poses(Recording(noise, rate_hz=100.0))


def test_a_sensor_of_two_axes_is_refused() -> None:
    with pytest.raises(SensorError, match="2 channels came"):
        find_poses(Recording(np.zeros((100, 2)), rate_hz=100.0))


def test_a_frozen_axis_has_no_rests_and_is_named() -> None:
    rng = np.random.default_rng(1)
    poses = np.repeat(rng.normal(0.0, 9.8, (12, 3)), 1001, axis=0) + rng.normal(0.0, 0.01, (12_012, 3))
    moved = np.concatenate([np.r_[rest, rng.normal(0.0, 5.0, (300, 3))] for rest in np.split(poses, 12)])
    assert len(find_rests(Recording(moved, rate_hz=100.0)).means) == 12
    moved[:, 1] = 0.1  # the means of its blocks differ in their last bits
    frozen = Recording(moved, names=["x", "y", "z"], rate_hz=100.0)
    assert not len(find_rests(frozen).means)
    with pytest.raises(SensorError, match="'y' never change"):
        find_poses(frozen)
