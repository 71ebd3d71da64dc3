"""When a gain has settled and when it only looks so: `core.reference` runs the full recursion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from becalm.core import reference
from becalm.core.arrays import Floats
from becalm.core.components import motion
from becalm.core.filtering import Estimate, kalman_filter
from becalm.core.model import Model
from becalm.core.online import Online
from becalm.core.smoothing import kalman_smoother

TWIN = 1e-12


def drawn(model: Model, rows: int) -> Floats:
    values: Floats = 2 * np.random.default_rng(rows).normal(size=(rows, model.channels))
    return values


def arrived(z: Floats) -> Floats:
    """What the reference is given: it knows no magnitude that no sensor reads."""
    usable: Floats = np.where(np.abs(z) <= 1e100, z, np.nan)
    return usable


def steps_of(model: Model, z: Floats) -> list[reference.Step]:
    assert model.x0 is not None
    assert model.P0 is not None
    belief = reference.Belief(model.x0, model.P0)
    return reference.filter_readings(belief, model.F, model.process_covariance, (model.H, model.R), arrived(z))


def assert_twins(got: Floats | None, expected: Any, measure: Any = None) -> None:
    """Agree to 1e-12 of each component's largest value, or that of what it is a difference of; NaN where NaN."""
    assert got is not None
    expected = np.asarray(expected).reshape(got.shape)
    size = np.nanmax(np.abs(expected if measure is None else np.asarray(measure)), axis=0, initial=0.0)
    assert np.array_equal(np.isnan(got), np.isnan(expected))
    assert np.nanmax(np.abs(got - expected) - TWIN * size, initial=0.0) <= 0


def variances(H: Floats, covs: list[Floats]) -> Floats:
    return np.array([np.maximum(np.diag(H @ P @ H.T), 0) for P in covs])


def assert_filter(got: Estimate, model: Model, steps: list[reference.Step]) -> None:
    means, covs = [step.filtered.mean for step in steps], [step.filtered.cov for step in steps]
    assert_twins(got.signal, [model.H @ mean for mean in means])
    assert_twins(got.sigma**2, variances(model.H, covs))
    if got.mean is not None:
        assert_twins(got.mean, means)
    assert_twins(got.innovations, [step.innovation for step in steps])
    assert got.log_likelihood == pytest.approx(sum(step.log_likelihood for step in steps), rel=TWIN)
    if got.cov is not None:
        assert_twins(got.cov, covs)


def assert_smoother(got: Estimate, model: Model, steps: list[reference.Step]) -> None:
    beliefs, covs = reference.smooth(steps, model.F, model.H), [step.filtered.cov for step in steps]
    assert_twins(got.signal, [model.H @ belief.mean for belief in beliefs])
    assert_twins(got.sigma**2, variances(model.H, [belief.cov for belief in beliefs]), variances(model.H, covs))
    if got.mean is not None:
        assert_twins(got.mean, [belief.mean for belief in beliefs], [step.filtered.mean for step in steps])
    if got.cov is not None:
        assert_twins(got.cov, [belief.cov for belief in beliefs], covs)


def assert_right(model: Model, z: Floats) -> None:
    """The filter and the smoother by every way that what is wanted opens, and the stream."""
    steps = steps_of(model, z)
    for states, covariances in ((False, False), (True, False), (True, True)):
        assert_filter(kalman_filter(model, z, states=states, covariances=covariances), model, steps)
        assert_smoother(kalman_smoother(model, z, states=states, covariances=covariances), model, steps)
    signal, sigma = Online(model).run(z)
    assert_twins(signal, [model.H @ step.filtered.mean for step in steps])
    assert_twins(sigma**2, variances(model.H, [step.filtered.cov for step in steps]))


def imu(Q: float, R: float) -> Model:
    """The paper's accelerometer, [V, a] at 10 kHz; V is never observed."""
    T = 1e-4
    return Model(
        np.array([[1, T], [0, 1]]), [[0, 1]], Q * np.eye(2), [[R]], G=T * np.eye(2), x0=[0, 0], P0=np.ones((2, 2))
    )


def test_the_speed_that_is_never_observed_does_not_keep_the_gain_from_settling() -> None:
    model = imu(1.0, 1e-6)
    z = 0.2 + 1e-3 * drawn(model, 5000)
    z[3000:3100] = np.nan
    assert_right(model, z)
    settled, grown = kalman_filter(model, z), kalman_filter(model, z, covariances=True)
    assert settled.settled_row is not None
    assert settled.settled_row < 1000
    assert grown.settled_row is None
    assert grown.cov is not None
    assert (np.diff(grown.cov[-500:, 0, 0]) > 0).all()


UNSTABLE: dict[str, tuple[Any, Any, Any]] = {
    "apart": ([[1.5, 0], [0, 1]], [[0, 1]], [[1, 0], [0, 1]]),
    "seen first": ([[1, 0], [0, 1.5]], [[1, 0]], [[1, 0], [0, 1]]),
    "fed by the seen one": ([[1.5, 1], [0, 1]], [[0, 1]], [[1, 0], [0, 1]]),
    "fed, and the seen one slow": ([[1.5, 1], [0, 1]], [[0, 1]], [[1, 0], [0, 0.01]]),
    "shrinking": ([[0.5, 1], [0, 1]], [[0, 1]], [[1, 0], [0, 1]]),
}


@pytest.mark.parametrize("name", UNSTABLE)
def test_an_unobserved_unstable_state_leaves_the_observed_one_exact(name: str) -> None:
    F, H, Q = UNSTABLE[name]
    seen = H[0].index(1)
    q = Q[seen][seen]
    both = Model(F, H, Q, [[1]], x0=np.eye(2)[1 - seen], P0=np.eye(2))
    alone = Model(F=[[1]], H=[[1]], Q=[[q]], R=[[1]], x0=[0], P0=[[1]])
    z = drawn(alone, 5000)
    z[2100:2110], z[4000] = np.nan, np.inf
    steps = steps_of(alone, z)
    for covariances in (False, True):
        got = kalman_filter(both, z, states=True, covariances=covariances)
        assert_filter(replace(got, mean=got.signal, cov=None), alone, steps)
        back = kalman_smoother(both, z, states=True, covariances=covariances)
        assert_smoother(replace(back, mean=back.signal, cov=None), alone, steps)
        for mean in (got.mean, back.mean):
            assert mean is not None
            assert np.array_equal(mean[:, seen], (got if mean is got.mean else back).signal[:, 0])
            assert np.isfinite(mean).all()
    signal, sigma = Online(both).run(z)
    assert_twins(signal, [step.filtered.mean for step in steps])
    assert_twins(sigma**2, [step.filtered.cov[0] for step in steps])


@pytest.mark.slow
def test_a_gain_that_settles_late_is_the_full_recursion() -> None:
    """The paper's gyroscope: closed-loop poles 0.905 and 0.9999 at 10 kHz."""
    T = 1e-4
    model = Model(
        np.array([[1, T], [0, 1]]), [[1, 0]], np.eye(2), [[1e-6]], G=T * np.eye(2), x0=[0, 0], P0=np.ones((2, 2))
    )
    z = 1e-3 * drawn(model, 200_000)
    means, spread, belief = np.empty((len(z), 2)), np.empty((len(z), 1)), reference.Belief(np.zeros(2), np.ones((2, 2)))
    for k, reading in enumerate(z):
        before = reference.predict(belief, model.F, model.process_covariance) if k else belief
        belief = reference.update(before, model.H, model.R, reading).filtered
        means[k], spread[k] = belief.mean, belief.cov[0, 0]
    got = kalman_filter(model, z, states=True)
    assert got.settled_row is not None
    assert 130_000 < got.settled_row < 165_000
    assert_twins(got.mean, means)
    assert_twins(got.sigma**2, spread)
    signal, sigma = Online(model).run(z)
    assert_twins(signal, means[:, :1])
    assert_twins(sigma**2, spread)


def test_a_gain_settles_again_after_every_gap() -> None:
    model = Model([[0.95, 0.5], [0, 0.9]], [[1, 0]], np.diag([0.1, 0.2]), [[1]], x0=[1, -1], P0=3 * np.eye(2))
    z = drawn(model, 4000)
    z[1024:1034], z[2048], z[3072] = np.nan, np.inf, 1e101  # where blocks begin: the one before each is settled
    got = kalman_filter(model, z)
    assert got.settled_row is not None
    first = got.settled_row
    assert first < 200
    for begin, end in ((first, 1024), (1234, 2048), (2248, 3072), (3272, 4000)):
        assert (got.sigma[begin:end] == got.sigma[begin]).all()
    assert_right(model, z)


def quarter_rate(P0: Any) -> Model:
    """A tone at a quarter of the rate whose phase is known and whose amplitude is not: every second gain is zero."""
    return Model([[0, -1], [1, 0]], [[1, 0]], np.zeros((2, 2)), [[1]], x0=[0, 0], P0=P0)


NEVER_SETTLE = {
    "known phase": quarter_rate(np.diag([1.0, 0.0])),
    "known phase, a row later": quarter_rate(np.diag([0.0, 1.0])),
    "little noise on a known level": Model([[1]], [[1]], [[1e-30]], [[1]], x0=[0], P0=[[0]]),
    "little noise that grows": Model([[1.05]], [[1]], [[1e-40]], [[1]], x0=[0], P0=[[0]]),
}


@pytest.mark.parametrize("name", NEVER_SETTLE)
def test_a_gain_that_looks_settled_and_is_not(name: str) -> None:
    """Gains are compared 32 rows apart: one that comes back, or is small and grows, has not settled."""
    model = NEVER_SETTLE[name]
    z = drawn(model, 1000)
    assert_filter(kalman_filter(model, z, states=True), model, steps_of(model, z))


@pytest.mark.parametrize("bursts", [19, 20, 21, 57, 58, 59])
def test_a_gain_that_is_the_same_after_every_gap_has_not_settled(bursts: int) -> None:
    """Bursts of 40 readings, gaps of 460: every burst ends as the one before, and no gain is the settled one."""
    model = Model([[1]], [[1]], [[1e-4]], [[1]], x0=[0], P0=[[1]])
    z = drawn(model, 500 * bursts + 4000)
    for begin in range(0, 500 * bursts, 500):
        z[begin : begin + 460] = np.nan
    steps = steps_of(model, z)
    assert_filter(kalman_filter(model, z, states=True), model, steps)
    sigma = Online(model).run(z)[1]
    assert_twins(sigma**2, [step.filtered.cov[0] for step in steps])


def moving(order: int, q: float, R: float, P0: float) -> Model:
    """A motion of one channel, from x0 = 0."""
    drawn_up = motion(order, q).to_model(1.0, 1.0)
    return Model(drawn_up.F, drawn_up.H, R * drawn_up.Q, [[R]], x0=np.zeros(order), P0=P0 * R * np.eye(order))


TURN = np.array([[0.995, -0.0998], [0.0998, 0.995]])
MOVING = {
    "level": moving(1, 1e-6, 1.0, 1.0),
    "level, P0 = 0": moving(1, 1e-6, 1.0, 0.0),
    "level, Q = 0": moving(1, 0.0, 1.0, 1.0),
    "slope": moving(2, 1e-10, 1.0, 1.0),
    "slope, tiny numbers": moving(2, 1e-10, 1e-60, 1.0),
    "slope, huge numbers": moving(2, 1e-10, 1e60, 1.0),
    "acceleration": moving(3, 1e-14, 1.0, 1.0),
    "jerk": moving(4, 1e-14, 1.0, 1e-3),
    "oscillator": Model(TURN, [[1, 0.5]], 1e-9 * np.eye(2), [[1]], x0=[1, 0], P0=np.eye(2)),
}


@pytest.mark.parametrize("name", MOVING)
def test_blocks_whose_gain_still_moves(name: str) -> None:
    """Nothing settles here, or late; one reading is missing, then a whole block."""
    model = MOVING[name]
    z = np.sqrt(model.R[0, 0]) * drawn(model, 2400)
    z[700], z[1281:1536] = np.nan, np.nan
    settled = kalman_filter(model, z).settled_row
    assert settled is None or settled > 512
    assert_right(model, z)
