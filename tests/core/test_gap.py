"""Towards the end of a long gap nearly all is known from later readings: sigma must not be a rounded difference.

A motion that starts from nothing is the same seen backwards in time. So what is hard to compute at the end of
a gap is easy at the start of the same gap in the reversed record: the reference for each is the other.
"""

from __future__ import annotations

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import Estimate
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import motion
from becalm.core.model.model import Model
from flows import flow_of

EDGE = 3000
EQUAL = 1e-7  # over a gap of g rows the covariance itself keeps about g^2 ulp of its smallest part


def gapped(rows: int, seed: int = 1) -> Floats:
    """Draw readings around a gap."""
    z = np.random.default_rng(seed).normal(size=rows + 2 * EDGE)
    z[EDGE : EDGE + rows] = np.nan
    return z


def smoothed_model(order: int) -> Model:
    return motion(order, 1e-3**order).to_model(1.0, 1.0)


def assert_mirrored(forth: Estimate, back: Estimate, equal: float = EQUAL) -> None:
    sigma, mirrored = forth.sigma[:, 0], back.sigma[::-1, 0]
    assert (sigma > 0).all()
    np.testing.assert_allclose(sigma, mirrored, rtol=equal)


@pytest.mark.parametrize(("order", "rows"), [(1, 100_000), (2, 100_000), (3, 1000), (3, 20_000), (4, 5000), (5, 3000)])
def test_sigma_is_the_same_from_both_sides(order: int, rows: int) -> None:
    model, z = smoothed_model(order), gapped(rows)
    assert_mirrored(kalman_smoother(model, z), kalman_smoother(model, z[::-1]))


def test_covariances_are_positive_and_those_of_sigma() -> None:
    model, z = smoothed_model(3), gapped(5000)
    got = kalman_smoother(model, z, states=True, covariances=True)
    assert got.cov is not None
    scale = np.sqrt(np.einsum("kii->ki", got.cov))
    correlation = got.cov / scale[:, :, np.newaxis] / scale[:, np.newaxis]
    assert np.linalg.eigvalsh(correlation).min() > -1e-9
    np.testing.assert_allclose(np.sqrt(got.cov[:, 0, 0]), got.sigma[:, 0], rtol=1e-12)
    np.testing.assert_allclose(got.sigma, kalman_smoother(model, z).sigma, rtol=EQUAL)


def test_a_lone_reading_within_the_gap() -> None:
    model, z = smoothed_model(3), gapped(9000)
    z[EDGE + 4000] = 0.5
    assert_mirrored(kalman_smoother(model, z), kalman_smoother(model, z[::-1]))


@pytest.mark.parametrize("rows", [1024, 2560])
def test_a_record_in_stretches_has_the_sigma_of_the_whole(rows: int) -> None:
    component, z = motion(3, 1e-9), gapped(9000)
    flow = flow_of(component, 1.0, causal=False)
    told = []
    for first in range(0, len(z), rows):
        told += flow.push(z[first : first + rows], np.ones(len(z[first : first + rows])))
    told += flow.finish()
    whole = kalman_smoother(component.to_model(1.0, 1.0), z)
    np.testing.assert_allclose(np.concatenate([part.sigma for part in told]), whole.sigma[:, 0], rtol=EQUAL)


def test_a_step_without_an_inverse_keeps_the_difference() -> None:
    model = Model([[1, 1], [0, 0]], [[1, 0]], np.diag([0.0, 1e-6]), 1.0, x0=[0, 0], P0=np.eye(2))
    got = kalman_smoother(model, gapped(2000))
    assert np.isfinite(got.sigma).all()
    assert (got.sigma > 0).all()
