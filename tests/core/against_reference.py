"""What several tests share: readings, what `core.reference` says of them, and comparing every result with it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import Estimate, kalman_filter
from becalm.core.filter.likelihood import log_likelihood
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.model import Model
from becalm.core.online import Online
from becalm.core.reference import kalman as reference
from becalm.core.steady.steady_filter import steady

TWIN = 1e-12


class Known(NamedTuple):
    """What the reference says of a record."""

    model: Model
    steps: list[reference.ReferenceStep]
    beliefs: list[reference.StateEstimate]  # smoothed; none where nothing is to be smoothed


def drawn(model: Model, rows: int) -> Floats:
    """Draw white readings (rows, m)."""
    values: Floats = 2 * np.random.default_rng(rows).normal(size=(rows, model.channels))
    return values


def arrived(z: Floats) -> Floats:
    """Return what the reference is given: it knows no magnitude that no sensor reads."""
    usable: Floats = np.where(np.abs(z) <= 1e100, z, np.nan)
    return usable


def known(model: Model, z: Floats, *, smooth: bool = True) -> Known:
    """Ask the reference; it is slow, so smooth only where that is compared."""
    assert model.x0 is not None
    assert model.P0 is not None
    belief = reference.StateEstimate(model.x0, model.P0)
    steps = reference.filter_readings(belief, model.F, model.process_covariance, (model.H, model.R), arrived(z))
    return Known(model, steps, reference.smooth(steps, model.F, model.H) if smooth else [])


def variances(H: Floats, covs: list[Floats]) -> Floats:
    """Return the variances of the signals (N, m)."""
    return np.array([np.maximum(np.diag(H @ P @ H.T), 0) for P in covs])


def assert_twins(got: Floats | None, expected: Any, measure: Any = None, name: str = "it") -> None:
    """Agree to 1e-12 of each component's largest value over the record; NaN where NaN.

    A smoothed covariance is a difference, P - P N P; its `measure` is the P that it is taken from.
    """
    assert got is not None, f"{name} is missing"
    expected = np.asarray(expected)
    size = np.nanmax(np.abs(expected if measure is None else np.asarray(measure)), axis=0, initial=0.0)
    assert got.shape == expected.shape, f"{name}: {got.shape} for {expected.shape}"
    assert np.array_equal(np.isnan(got), np.isnan(expected)), f"{name}: NaN elsewhere"
    excess = np.nanmax(np.abs(got - expected) - TWIN * size, initial=0.0)
    assert excess <= 0, f"{name}: {excess} beyond 1e-12 of {size}"


def assert_filter(got: Estimate, about: Known, *, states: bool = True, scale: float | None = None) -> None:
    """Compare every result of the filter; variances are measured by their own size unless a `scale` is given."""
    assert (got.mean is not None) == states
    _assert_beliefs(got, about, [step.filtered for step in about.steps], (None, scale))
    _assert_innovations(got, about)


def assert_smoother(
    got: Estimate, about: Known, *, states: bool = True, scale: float | None = None, corrected: bool = False
) -> None:
    """Compare every result of the smoother; its innovations and likelihood are the filter's.

    A smoothed state is x + P r; where that leaves much less than the filtered x is (`corrected`), x measures it.
    """
    assert (got.mean is not None) == states
    assert len(about.beliefs) == len(about.steps), "the reference was not asked to smooth"
    means = np.array([step.filtered.mean for step in about.steps]) if corrected else None
    _assert_beliefs(got, about, about.beliefs, (means, scale))
    _assert_innovations(got, about)


def _assert_beliefs(
    got: Estimate, about: Known, beliefs: list[reference.StateEstimate], measure: tuple[Floats | None, float | None]
) -> None:
    H, (means, scale), before = about.model.H, measure, [step.filtered.cov for step in about.steps]
    covs = [belief.cov for belief in beliefs]
    assert_twins(got.signal, [H @ belief.mean for belief in beliefs], name="signal")
    size = variances(H, before) if scale is None else np.full((1, len(H)), scale)
    assert_twins(got.sigma**2, variances(H, covs), size, name="sigma^2")
    if got.mean is not None:
        assert_twins(got.mean, [belief.mean for belief in beliefs], means, name="mean")
    if got.cov is not None:
        assert_twins(got.cov, covs, before if scale is None else np.full((1, *covs[0].shape), scale), name="cov")


def _assert_innovations(got: Estimate, about: Known) -> None:
    innovations = np.array([step.innovation for step in about.steps])
    spread = np.full(innovations.shape, np.nan)
    for k, step in enumerate(about.steps):
        spread[k, np.isfinite(innovations[k])] = np.diag(step.innovation_cov)
    assert_twins(got.innovations, innovations, name="innovations")
    assert_twins(got.innovation_sigma**2, spread, name="innovation_sigma^2")
    assert got.log_likelihood == pytest.approx(sum(step.log_likelihood for step in about.steps), rel=TWIN)
    assert got.used == sum(np.linalg.matrix_rank(step.innovation_cov, hermitian=True) for step in about.steps)


def assert_online(about: Known, z: Floats) -> None:
    """Compare what a stream says of the readings."""
    H, steps = about.model.H, about.steps
    signal, sigma = Online(about.model).run(z)
    assert_twins(signal, [H @ step.filtered.mean for step in steps], name="the stream's signal")
    assert_twins(sigma**2, variances(H, [step.filtered.cov for step in steps]), name="the stream's sigma^2")


def settled_by(shrinking: float, start: float = 1.0, every: float = 32.0) -> float:
    """Return the row by which a gain has been noticed to have settled, but for the n rows that confirm it.

    Its distance from the settled gain, `start` times what it is measured by, shrinks by `shrinking` a row (rho^2,
    rho the slowest pole of the closed loop) to 1e-13. The first check from there on may come an eighth of the
    stretch later, or `every` rows; it compares with the check before, so that only the next one is sure to notice.
    """
    rows = np.log(1e-13 / start) / np.log(shrinking)
    for _ in range(2):
        rows = max(rows + every, 1.125 * rows)
    return float(rows)


def slowest_pole(model: Model) -> float:
    """Return the largest modulus of the settled filter's poles."""
    return float(np.abs(np.linalg.eigvals(steady(model).closed_loop)).max())


def assert_right(model: Model, z: Floats, *, corrected: bool = False) -> None:
    """Compare the filter and the smoother by every way that what is wanted opens, and the stream."""
    about = known(model, z)
    for states, covariances in ((False, False), (True, False), (True, True)):
        got = kalman_filter(model, z, states=states, covariances=covariances)
        back = kalman_smoother(model, z, states=states, covariances=covariances)
        assert (got.cov is not None, back.cov is not None) == (covariances, covariances)
        assert_filter(got, about, states=states)
        assert_smoother(back, about, states=states, corrected=corrected)
    assert log_likelihood(model, z) == kalman_filter(model, z).log_likelihood
    assert_online(about, z)
