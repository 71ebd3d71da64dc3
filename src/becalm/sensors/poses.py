"""Calibrate a triaxial accelerometer at rest: the magnitude of gravity is the same in every pose.

No equipment is needed: the sensor rests in many poses, and scale, bias and skew of its axes are fitted so that the
magnitude of the acceleration is equal in all poses. Gravity does not show how the axes are oriented in space. Therefore
the third axis keeps its direction, and the second keeps its plane with the third (the upper triangular matrix of
Tedaldi, Pretto and Menegatti, ICRA 2014). If directions are known, as for the six faces of a cube, linear least squares
gives all parameters (IEEE 1293).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats
from becalm.errors import SensorError
from becalm.sensors.checks import STANDARD_GRAVITY, finite_array, positive

FEWEST_POSES = 10
"""Least number of rests in different poses: one more than the number of unknowns."""

FEWEST_DIRECTIONS = 5
"""Least number of rests in known directions: one more than the number of unknowns per axis."""

_UPPER = np.triu_indices(3)  # entries of the matrix that are fitted
_UNKNOWNS = 9  # six entries of the matrix, three of the bias
_UNKNOWNS_AN_AXIS = 4  # three sensitivities and a bias
_POOR = 0.005  # least singular value over root of rests: 0.1 to 0.2 for a full sphere of poses, 0.04 for half of it
_ROUNDS = 3  # number of fits, each with weights from the previous fit


class Rests(NamedTuple):
    """Readings at rest.

    Attributes
    ----------
    means : (k, 3) float array
        Mean of the readings of each rest, in the unit of readings.
    stds : (k, 3) float array
        Standard errors of the means, in the unit of readings.
    """

    means: Floats
    stds: Floats


class PoseCalibration(NamedTuple):
    """The calibration of an accelerometer with readings v: a = matrix (v - bias).

    Attributes
    ----------
    matrix, matrix_std : (3, 3) float array
        Calibration matrix and its standard errors, in unit of gravity per reading.
    bias, bias_std : (3,) float array
        Bias and its standard errors, in the unit of readings.
    excess : float
        Root mean square of the residuals, in standard errors of the rests; if it is above 1, the standard errors of
        matrix and bias contain it as a factor.
    """

    matrix: Floats
    matrix_std: Floats
    bias: Floats
    bias_std: Floats
    excess: float

    def acceleration(self, readings: Floats) -> Floats:
        """Return accelerations (n, 3), in unit of gravity, from readings (n, 3)."""
        return np.asarray((readings - self.bias) @ self.matrix.T)

    def spread(self, means: Floats) -> float:
        """Return the standard deviation of |a| over rests (k, 3), in unit of gravity."""
        return float(np.linalg.norm(self.acceleration(means), axis=1).std())


def common_factor(means: Floats, zero: Floats, gravity: float = STANDARD_GRAVITY) -> PoseCalibration:
    """Return the calibration with a given zero (3,) and one factor for all axes; its standard errors are NaN.

    Raises
    ------
    SensorError
        If all rests (k, 3) equal the zero, or gravity is not positive.
    """
    length = float(np.linalg.norm(means - zero, axis=1).mean())
    factor = positive("gravity", gravity, "9.80665") / positive("mean length of the rests", length, "1.0")
    return PoseCalibration(factor * np.eye(3), np.full((3, 3), np.nan), zero, np.full(3, np.nan), np.nan)


def calibrate_by_length(rests: Rests, gravity: float = STANDARD_GRAVITY) -> PoseCalibration:
    """Return the calibration from rests in unknown poses.

    Parameters
    ----------
    rests : Rests
        At least ten poses over the full sphere: each axis up and down, and edges and corners between.
    gravity : float
        Gravity at the place of the sensor, in the unit of the result.

    Returns
    -------
    PoseCalibration
        The calibration, with an upper triangular matrix.

    Raises
    ------
    SensorError
        If there are fewer than ten rests, they are too similar for nine unknowns, or a number is impossible.
    """
    means, stds = _checked(rests, FEWEST_POSES, "poses")
    g = positive("gravity", gravity, "9.80665")
    centre, radius = nearest_sphere(means)
    u, u_std = (means - centre) / radius, stds / radius  # lengths near 1, so that all unknowns are of similar size
    p = np.concatenate([np.eye(3)[_UPPER], np.zeros(3)])
    _require_variety(_slopes(p, u))
    for _ in range(_ROUNDS):  # the weights of the rests depend slightly on the fit
        weight = 1 / _length_std(p, u, u_std)
        p = _fitted(p, u, weight)
    J, residual = weight[:, np.newaxis] * _slopes(p, u), weight * (_length(p, u) - 1)
    _require_variety(_slopes(p, u))
    excess = float(np.sqrt(residual @ residual / (len(u) - _UNKNOWNS)))
    std = max(1.0, excess) * np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    M, b = _unpacked(p)
    M_std, b_std = _unpacked(std)
    return PoseCalibration(M * g / radius, M_std * g / radius, centre + radius * b, radius * b_std, excess)


def _fitted(p: Floats, u: Floats, weight: Floats) -> Floats:
    """Return the least-squares unknowns (9,) for lengths of 1, from an initial guess."""
    from scipy.optimize import least_squares

    w = weight / weight.mean()

    def residual(p: Floats) -> Floats:
        return np.asarray(w * (_length(p, u) - 1))

    def slopes(p: Floats) -> Floats:
        return np.asarray(w[:, np.newaxis] * _slopes(p, u))

    fit = least_squares(residual, p, slopes)
    return np.asarray(fit.x)


def calibrate_by_direction(rests: Rests, accelerations: Floats) -> PoseCalibration:
    """Return the calibration from rests in known directions, such as the six faces of a cube.

    Parameters
    ----------
    rests : Rests
        At least five rests; usually six, one per face.
    accelerations : (k, 3) float array
        True acceleration at each rest, in the unit of the result: (0, 0, g) with the third axis up.

    Raises
    ------
    SensorError
        If there are fewer than five rests, the directions do not span the space, the readings of an axis depend on
        those of another, or a number is impossible.
    """
    means, stds = _checked(rests, FEWEST_DIRECTIONS, "known directions")
    a = finite_array("accelerations", accelerations, means.shape)
    size = positive("mean length of accelerations", float(np.linalg.norm(a, axis=1).mean()), "9.80665")
    design = np.column_stack([a / size, np.ones(len(a))])
    _require_variety(design)
    axes = [_line(design, mean, std) for mean, std in zip(means.T, stds.T, strict=True)]
    S, b = np.array([axis.row[:3] for axis in axes]), np.array([axis.row[3] for axis in axes])
    strengths = np.linalg.svd(S, compute_uv=False)
    if not strengths[-1] > _POOR * strengths[0]:
        raise SensorError("One axis reads like another, or does not change with the direction; check its wiring.")
    excess = float(np.sqrt(sum(axis.squares for axis in axes) / (3 * (len(a) - _UNKNOWNS_AN_AXIS))))
    wider, C = max(1.0, excess), np.linalg.inv(S)
    # C changes by -C dS C; the errors of the rows of S are independent
    row_variances = np.array([np.einsum("jl,jk,kl->l", C, axis.covariance[:3, :3], C) for axis in axes])
    b_std = wider * np.sqrt([axis.covariance[3, 3] for axis in axes])
    return PoseCalibration(C * size, wider * np.sqrt(C**2 @ row_variances) * size, b, b_std, excess)


class _Line(NamedTuple):
    """Sensitivity of one axis to the three directions, and its bias."""

    row: Floats  # (4,) sensitivities and bias, in readings
    covariance: Floats  # (4, 4) of the row
    squares: float  # sum of squared residuals, in standard errors


def _line(design: Floats, mean: Floats, std: Floats) -> _Line:
    J, target = design / std[:, np.newaxis], mean / std
    covariance: Floats = np.asarray(np.linalg.inv(J.T @ J), dtype=np.float64)
    row: Floats = np.asarray(np.linalg.lstsq(J, target)[0], dtype=np.float64)
    return _Line(row, covariance, float(np.sum((J @ row - target) ** 2)))


def _checked(rests: Rests, fewest: int, what: str) -> tuple[Floats, Floats]:
    """Return means and standard errors, (k, 3) each, after a check of their number and values."""
    count = len(np.asarray(rests.means))
    if count < fewest:
        raise SensorError(f"{count} rests came; at least {fewest} in different {what} are needed. Add more poses.")
    means, stds = finite_array("means", rests.means, (count, 3)), finite_array("stds", rests.stds, (count, 3))
    if not (stds > 0).all():
        raise SensorError("A standard error of a rest is not positive; give those of the means, in readings.")
    return means, stds


def nearest_sphere(means: Floats) -> tuple[Floats, float]:
    """Return centre (3,) and radius of the sphere nearest to points (k, 3), by |x|^2 = 2 x c + (r^2 - |c|^2).

    Raises
    ------
    SensorError
        If the points lie in a plane, or nearly so.
    """
    middle = means.mean(axis=0)
    size = float(np.sqrt(np.mean((means - middle) ** 2))) or 1.0
    x = (means - middle) / size
    design = np.column_stack([2 * x, np.ones(len(x))])
    _require_variety(design)
    *centre, rest = np.linalg.lstsq(design, np.sum(x**2, axis=1))[0]
    radius = float(np.sqrt(rest + np.dot(centre, centre)))
    return middle + size * np.array(centre), size * radius


def _unpacked(p: Floats) -> tuple[Floats, Floats]:
    """Return the upper triangular matrix (3, 3) and the vector (3,) in the unknowns (9,)."""
    M = np.zeros((3, 3))
    M[_UPPER] = p[:6]
    return M, p[6:]


def _length(p: Floats, u: Floats) -> Floats:
    """Return |M (u - b)|, (k,)."""
    M, b = _unpacked(p)
    return np.asarray(np.linalg.norm((u - b) @ M.T, axis=1))


def _slopes(p: Floats, u: Floats) -> Floats:
    """Return the derivatives (k, 9) of |M (u - b)| with respect to the six entries of M and the three of b."""
    M, b = _unpacked(p)
    a = (u - b) @ M.T
    along = a / np.linalg.norm(a, axis=1, keepdims=True)
    by_matrix = along[:, :, np.newaxis] * (u - b)[:, np.newaxis, :]
    return np.column_stack([by_matrix[:, *_UPPER], -along @ M])


def _length_std(p: Floats, u: Floats, u_std: Floats) -> Floats:
    """Return the standard error of each length, (k,)."""
    toward_b = _slopes(p, u)[:, 6:]
    return np.asarray(np.sqrt(np.sum((toward_b * u_std) ** 2, axis=1)))


def _require_variety(design: Floats) -> None:
    """Raise an error if k poses, the rows, hardly determine a combination of the unknowns, which have a size of 1."""
    strengths = np.linalg.svd(design, compute_uv=False) / np.sqrt(len(design))
    if not strengths[-1] > _POOR:
        raise SensorError(
            "The rests are too similar to distinguish scale, bias and skew of all axes. "
            "Lay the sensor down on each of its faces, and on edges and corners between."
        )
