"""A triaxial accelerometer calibrated by rest: gravity is as long in every pose.

Nothing but the sensor is needed: it is laid down in many poses, and scale, bias and skew of its axes are those
that make |a| the same in all. Which way its axes point in space gravity cannot tell; so the third axis is taken as
it is, the second lies in a plane with it (the upper triangular matrix of Tedaldi, Pretto and Menegatti, ICRA 2014).
Where directions are known, as on the six faces of a cube, everything is found by linear least squares (IEEE 1293).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.checks import STANDARD_GRAVITY, finite_array, positive

FEWEST_POSES = 10
"""Rests in different poses: one more than there are unknowns."""

FEWEST_DIRECTIONS = 5
"""Rests of known directions: one more than there are unknowns an axis."""

_UPPER = np.triu_indices(3)
_UNKNOWNS = 9
_UNKNOWNS_AN_AXIS = 4
_POOR = 0.005  # least singular value over root of rests: all around it is 0.1 to 0.2, over half of a sphere 0.04
_ROUNDS = 3


class Rests(NamedTuple):
    """What was read at rest.

    Attributes
    ----------
    means : (k, 3) float array
        Of each rest, in readings.
    stds : (k, 3) float array
        Their standard errors, in readings.
    """

    means: Floats
    stds: Floats


class PoseCalibration(NamedTuple):
    """What readings v are turned into accelerations with: a = matrix (v - bias).

    Attributes
    ----------
    matrix, matrix_std : (3, 3) float array
        In unit of gravity per reading, and its standard errors.
    bias, bias_std : (3,) float array
        In readings, and its standard errors.
    excess : float
        By how much rests differ from the model, over their standard errors, root mean square; where it is above 1,
        the standard errors told here are larger by as much.
    """

    matrix: Floats
    matrix_std: Floats
    bias: Floats
    bias_std: Floats
    excess: float

    def acceleration(self, readings: Floats) -> Floats:
        """Return accelerations (n, 3) of readings (n, 3)."""
        return np.asarray((readings - self.bias) @ self.matrix.T)

    def spread(self, means: Floats) -> float:
        """Return the standard deviation of |a| over rests (k, 3), in unit of gravity."""
        return float(np.linalg.norm(self.acceleration(means), axis=1).std())


def common_factor(means: Floats, zero: Floats, gravity: float = STANDARD_GRAVITY) -> PoseCalibration:
    """Return what stands for no calibration: a zero (3,) and one factor for all axes, with no errors told.

    Raises
    ------
    SensorError
        If the rests (k, 3) have no length about the zero, or gravity is not positive.
    """
    length = float(np.linalg.norm(means - zero, axis=1).mean())
    factor = positive("gravity", gravity, "9.80665") / positive("mean length of the rests", length, "1.0")
    return PoseCalibration(factor * np.eye(3), np.full((3, 3), np.nan), zero, np.full(3, np.nan), np.nan)


def calibrate_by_length(rests: Rests, gravity: float = STANDARD_GRAVITY) -> PoseCalibration:
    """Calibrate by rests in any poses, of which nothing is known.

    Parameters
    ----------
    rests : Rests
        Ten poses at least, all around: each axis up and down, and edges and corners between.
    gravity : float
        Where the sensor lay, in the unit that is wanted.

    Returns
    -------
    PoseCalibration
        With an upper triangular matrix.

    Raises
    ------
    SensorError
        If there are fewer than ten rests, they are too alike to tell nine unknowns, or a number is impossible.
    """
    means, stds = _checked(rests, FEWEST_POSES, "poses")
    g = positive("gravity", gravity, "9.80665")
    centre, radius = nearest_sphere(means)
    u, u_std = (means - centre) / radius, stds / radius  # of length 1, about: all unknowns are of one size
    p = np.concatenate([np.eye(3)[_UPPER], np.zeros(3)])
    _refuse_alike(_slopes(p, u))
    for _ in range(_ROUNDS):  # what a rest weighs depends on the fit, slightly
        weight = 1 / _length_std(p, u, u_std)
        p = _fitted(p, u, weight)
    J, left = weight[:, np.newaxis] * _slopes(p, u), weight * (_length(p, u) - 1)
    _refuse_alike(_slopes(p, u))
    excess = float(np.sqrt(left @ left / (len(u) - _UNKNOWNS)))
    std = max(1.0, excess) * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    M, b = _unpacked(p)
    M_std, b_std = _unpacked(std)
    return PoseCalibration(M * g / radius, M_std * g / radius, centre + radius * b, radius * b_std, excess)


def _fitted(p: Floats, u: Floats, weight: Floats) -> Floats:
    """Return the unknowns (9,) by which lengths are nearest to 1, from a first guess."""
    from scipy.optimize import least_squares

    w = weight / weight.mean()

    def left(p: Floats) -> Floats:
        return np.asarray(w * (_length(p, u) - 1))

    def slopes(p: Floats) -> Floats:
        return np.asarray(w[:, np.newaxis] * _slopes(p, u))

    found = least_squares(left, p, slopes)
    return np.asarray(found.x)


def calibrate_by_direction(rests: Rests, accelerations: Floats) -> PoseCalibration:
    """Calibrate by rests whose directions are known, as the six faces of a cube.

    Parameters
    ----------
    rests : Rests
        Five at least; six, one a face, are usual.
    accelerations : (k, 3) float array
        What each should have read, in the unit that is wanted: (0, 0, g) with the third axis up.

    Raises
    ------
    SensorError
        If there are fewer than five rests, they do not turn every axis, or an axis tells nothing.
    """
    means, stds = _checked(rests, FEWEST_DIRECTIONS, "known directions")
    a = finite_array("accelerations", accelerations, means.shape)
    size = positive("mean length of accelerations", float(np.linalg.norm(a, axis=1).mean()), "9.80665")
    design = np.column_stack([a / size, np.ones(len(a))])
    _refuse_alike(design)
    axes = [_line(design, mean, std) for mean, std in zip(means.T, stds.T, strict=True)]
    S, b = np.array([axis.row[:3] for axis in axes]), np.array([axis.row[3] for axis in axes])
    strengths = np.linalg.svd(S, compute_uv=False)
    if not strengths[-1] > _POOR * strengths[0]:
        raise SensorError("One axis reads as another does, or does not turn with its sensor; look at its wiring.")
    excess = float(np.sqrt(sum(axis.squares for axis in axes) / (3 * (len(a) - _UNKNOWNS_AN_AXIS))))
    wider, C = max(1.0, excess), np.linalg.inv(S)
    # C changes by -C dS C; rows of S know nothing of each other
    heard = np.array([np.einsum("jl,jk,kl->l", C, axis.covariance[:3, :3], C) for axis in axes])
    b_std = wider * np.sqrt([axis.covariance[3, 3] for axis in axes])
    return PoseCalibration(C * size, wider * np.sqrt(C**2 @ heard) * size, b, b_std, excess)


class _Line(NamedTuple):
    """How one axis hears the three directions, and its bias."""

    row: Floats
    covariance: Floats
    squares: float  # of what is left over, in standard errors


def _line(design: Floats, mean: Floats, std: Floats) -> _Line:
    J, wanted = design / std[:, np.newaxis], mean / std
    covariance: Floats = np.asarray(np.linalg.inv(J.T @ J), dtype=np.float64)
    row: Floats = np.asarray(np.linalg.lstsq(J, wanted)[0], dtype=np.float64)
    return _Line(row, covariance, float(np.sum((J @ row - wanted) ** 2)))


def _checked(rests: Rests, fewest: int, what: str) -> tuple[Floats, Floats]:
    """Return means and standard errors, each (k, 3), of enough rests."""
    count = len(np.asarray(rests.means))
    if count < fewest:
        raise SensorError(f"{count} rests came; at least {fewest} in different {what} are needed. Lay it down in more.")
    means, stds = finite_array("means", rests.means, (count, 3)), finite_array("stds", rests.stds, (count, 3))
    if not (stds > 0).all():
        raise SensorError("A standard error of a rest is not positive; give those of the means, in readings.")
    return means, stds


def nearest_sphere(means: Floats) -> tuple[Floats, float]:
    """Return centre (3,) and radius of the sphere nearest to points (k, 3), by |x|^2 = 2 x c + (r^2 - |c|^2).

    Raises
    ------
    SensorError
        If they lie in a plane, or nearly.
    """
    middle = means.mean(axis=0)
    size = float(np.sqrt(np.mean((means - middle) ** 2))) or 1.0
    x = (means - middle) / size
    design = np.column_stack([2 * x, np.ones(len(x))])
    _refuse_alike(design)
    *centre, rest = np.linalg.lstsq(design, np.sum(x**2, axis=1))[0]
    radius = float(np.sqrt(rest + np.dot(centre, centre)))
    return middle + size * np.array(centre), size * radius


def _unpacked(p: Floats) -> tuple[Floats, Floats]:
    """Return the upper triangle (3, 3) and the three numbers behind it."""
    M = np.zeros((3, 3))
    M[_UPPER] = p[:6]
    return M, p[6:]


def _length(p: Floats, u: Floats) -> Floats:
    """Return |M (u - b)|, (k,)."""
    M, b = _unpacked(p)
    return np.asarray(np.linalg.norm((u - b) @ M.T, axis=1))


def _slopes(p: Floats, u: Floats) -> Floats:
    """Return d |M (u - b)| over the six numbers of M and the three of b, (k, 9)."""
    M, b = _unpacked(p)
    a = (u - b) @ M.T
    along = a / np.linalg.norm(a, axis=1, keepdims=True)
    by_matrix = along[:, :, np.newaxis] * (u - b)[:, np.newaxis, :]
    return np.column_stack([by_matrix[:, *_UPPER], -along @ M])


def _length_std(p: Floats, u: Floats, u_std: Floats) -> Floats:
    """Return the standard error of each length, (k,)."""
    toward_b = _slopes(p, u)[:, 6:]
    return np.asarray(np.sqrt(np.sum((toward_b * u_std) ** 2, axis=1)))


def _refuse_alike(design: Floats) -> None:
    """Refuse poses (k rows) that leave a combination of unknowns, each of size 1, almost untold."""
    strengths = np.linalg.svd(design, compute_uv=False) / np.sqrt(len(design))
    if not strengths[-1] > _POOR:
        raise SensorError(
            "The rests are too alike: they do not tell scale, bias and skew of all axes apart. "
            "Lay the sensor down on each of its faces, and on edges and corners between."
        )
