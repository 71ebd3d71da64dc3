"""Rests tell matrix and bias within their standard errors; poses too few or too alike tell nothing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.poses import PoseCalibration, Rests, calibrate_by_direction, calibrate_by_length, common_factor

G = 9.80665
SEEDS = 200
UPPER = np.array([[2.41e-3, -9e-6, -4e-5], [0, 2.42e-3, 5e-5], [0, 0, 2.40e-3]])
FULL = UPPER + np.array([[0, 0, 0], [3e-5, 0, 0], [-2e-5, 6e-5, 0]])
BIAS = np.array([33_120.0, 33_270.0, 32_370.0])
FACES = G * np.vstack([np.eye(3), -np.eye(3)])


def all_around(count: int, seed: int = 0) -> Floats:
    """Return poses (count, 3) on a spiral from pole to pole."""
    z, angle = np.linspace(-1, 1, count), seed + np.pi * (1 + 5**0.5) * np.arange(count)
    across = np.sqrt(1 - z**2)
    return np.asarray(G * np.column_stack([across * np.cos(angle), across * np.sin(angle), z]))


def rests(accelerations: Floats, matrix: Floats, seed: int, noise: float = 0.3) -> Rests:
    """Return what an accelerometer reads, its standard errors differing from rest to rest and axis to axis."""
    rng = np.random.default_rng(seed)
    stds = noise * rng.uniform(0.3, 3.0, accelerations.shape)
    return Rests(accelerations @ np.linalg.inv(matrix).T + BIAS + stds * rng.normal(size=stds.shape), stds)


def by_length(seed: int) -> PoseCalibration:
    return calibrate_by_length(rests(all_around(24), UPPER, seed))


def by_faces(seed: int) -> PoseCalibration:
    return calibrate_by_direction(rests(FACES, FULL, seed), FACES)


@pytest.mark.parametrize(
    ("calibrated", "matrix", "free"), [(by_length, UPPER, 15), (by_faces, FULL, 6)], ids=["poses", "six positions"]
)
def test_the_truth_is_within_the_standard_errors(
    calibrated: Callable[[int], PoseCalibration], matrix: Floats, free: int
) -> None:
    """Errors are told wider, never narrower, where rests leave more over than they should: by `excess`."""
    found = [calibrated(seed) for seed in range(SEEDS)]
    known = matrix != 0
    own = np.array([max(1.0, one.excess) for one in found])[:, np.newaxis]
    errors = np.array([np.append((one.matrix - matrix)[known], one.bias - BIAS) for one in found])
    told = np.array([np.append(one.matrix_std[known], one.bias_std) for one in found])
    power = np.mean((errors / (told / own)) ** 2, axis=0)
    np.testing.assert_allclose(power, 1.0, atol=4.5 * np.sqrt(2 / SEEDS))
    assert np.mean([one.excess**2 for one in found]) == pytest.approx(1.0, abs=4.5 * np.sqrt(2 / free / SEEDS))
    assert np.mean(np.abs(errors) < 2 * told) > 0.93


def test_errors_are_wider_where_rests_do_not_fit() -> None:
    means, stds = rests(all_around(24), UPPER, 1)
    honest, bold = calibrate_by_length(Rests(means, stds)), calibrate_by_length(Rests(means, stds / 10))
    assert bold.excess == pytest.approx(10 * honest.excess, rel=1e-6)
    np.testing.assert_allclose(bold.bias, honest.bias, rtol=1e-9)
    np.testing.assert_allclose(bold.bias_std, honest.bias_std / 10 * bold.excess / max(1, honest.excess), rtol=1e-5)


@given(seed=st.integers(0, 1000), scale=st.floats(1e-6, 1e6), shift=st.floats(-10, 10))
def test_poses_know_no_unit(seed: int, scale: float, shift: float) -> None:
    exact = all_around(20, seed) @ np.linalg.inv(UPPER).T * scale
    span = np.ptp(exact)
    found = calibrate_by_length(Rests(exact + shift * span, np.full(exact.shape, 1e-4 * span)))
    np.testing.assert_allclose(found.matrix * scale, UPPER, atol=1e-9 * UPPER.max())
    np.testing.assert_allclose(found.bias, shift * span, atol=1e-9 * span)


def test_poses_alone_leave_a_rotation_and_lengths_the_same() -> None:
    """Of a full matrix only lengths can be right: it is found up to the way its axes point."""
    exact = Rests(all_around(24) @ np.linalg.inv(FULL).T + BIAS, np.full((24, 3), 0.1))
    found = calibrate_by_length(exact)
    rotation = found.matrix @ np.linalg.inv(FULL)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-9)
    assert found.spread(exact.means) < 1e-6 * common_factor(exact.means, BIAS).spread(exact.means)


def cap(degrees: float, count: int = 40) -> Floats:
    """Return poses that differ by the angle from one direction at most."""
    poses = all_around(20_000)
    near = poses[poses[:, 2] >= G * np.cos(np.radians(degrees))]
    return np.asarray(near[:: max(1, len(near) // count)])


ALIKE = {
    "one pose": np.tile([[0.0, 0.0, G]], (12, 1)),
    "faces only": np.vstack([FACES, FACES]),  # tell no skew
    "one plane": np.column_stack([all_around(24)[:, :2], np.zeros(24)]),
    "a cap of 30 degrees": cap(30),
}


@pytest.mark.parametrize("kind", ALIKE)
def test_poses_too_alike_are_refused(kind: str) -> None:
    with pytest.raises(SensorError, match="too similar"):
        calibrate_by_length(rests(ALIKE[kind], UPPER, 0))


def test_half_a_sphere_is_enough_and_told_as_worse() -> None:
    half, whole = (calibrate_by_length(rests(poses, UPPER, 0)) for poses in (cap(90), all_around(40)))
    assert half.bias_std.max() > 2 * whole.bias_std.max()
    assert (np.abs(half.bias - BIAS) < 4 * half.bias_std).all()


def test_too_few_rests_are_refused() -> None:
    with pytest.raises(SensorError, match="9 rests came; at least 10"):
        calibrate_by_length(rests(all_around(9), UPPER, 0))
    with pytest.raises(SensorError, match="4 rests came; at least 5"):
        calibrate_by_direction(rests(FACES[:4], FULL, 0), FACES[:4])


def test_directions_that_do_not_turn_an_axis_are_refused() -> None:
    turned = np.vstack([FACES[[0, 1, 3, 4]], FACES[:2]])
    with pytest.raises(SensorError, match="too similar"):
        calibrate_by_direction(rests(turned, FULL, 0), turned)


def test_a_dead_axis_is_refused() -> None:
    means, stds = rests(FACES, FULL, 0)
    means[:, 1] = means[:, 0]
    with pytest.raises(SensorError, match="reads like another"):
        calibrate_by_direction(Rests(means, stds), FACES)


def test_impossible_rests_are_refused() -> None:
    means, stds = rests(all_around(12), UPPER, 0)
    with pytest.raises(SensorError, match="standard error of a rest is not positive"):
        calibrate_by_length(Rests(means, 0 * stds))
    with pytest.raises(SensorError, match="not finite"):
        calibrate_by_length(Rests(np.where(means > means.min(), means, np.nan), stds))
    with pytest.raises(SensorError, match=r"stds has shape \(11, 3\)"):
        calibrate_by_length(Rests(means, stds[1:]))
