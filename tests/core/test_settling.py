"""When a gain has settled and when it only looks so: `core.reference` runs the full recursion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from against_reference import (
    assert_filter,
    assert_online,
    assert_right,
    assert_smoother,
    assert_twins,
    drawn,
    known,
    settled_by,
    slowest_pole,
)
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import motion
from becalm.core.model.model import Model
from becalm.core.online import Online
from becalm.core.reference import kalman as reference
from becalm.core.steady.steady_filter import steady


def imu(Q: float, R: float) -> Model:
    """The IMU paper's form of an accelerometer, [V, a] at 10 kHz; V is never observed."""
    T = 1e-4
    return Model(
        np.array([[1, T], [0, 1]]), [[0, 1]], Q * np.eye(2), [[R]], G=T * np.eye(2), x0=[0, 0], P0=np.ones((2, 2))
    )


def test_the_speed_that_is_never_observed_does_not_keep_the_gain_from_settling() -> None:
    Q, R = 1.0, 1e-6
    model = imu(Q, R)
    z = 0.2 + 1e-3 * drawn(model, 5000)
    z[3000:3100] = np.nan
    assert_right(model, z)
    settled, grown = kalman_filter(model, z), kalman_filter(model, z, covariances=True)
    assert settled.settled_row is not None
    # P of V and a shrinks by one pole of each, V's being 1. Nothing but itself measures the gain of V, whose variance
    # never settles: it comes from 1 and stays T (1 - K). Checks come at the ends of blocks.
    pole = slowest_pole(Model([[1]], [[1]], [[1e-8 * Q]], [[R]]))
    assert settled.settled_row <= settled_by(pole, start=1 / (1e-4 * pole), every=256) + 3
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
    about = known(alone, z)
    for covariances in (False, True):
        got = kalman_filter(both, z, states=True, covariances=covariances)
        assert_filter(replace(got, mean=got.signal, cov=None), about)
        back = kalman_smoother(both, z, states=True, covariances=covariances)
        assert_smoother(replace(back, mean=back.signal, cov=None), about)
        assert got.mean is not None
        assert back.mean is not None
        assert np.array_equal(got.mean[:, seen], got.signal[:, 0])
        assert_twins(back.mean[:, seen], back.signal[:, 0])  # found in two ways: x + P r, and from z
        assert np.isfinite([got.mean, back.mean]).all()
    signal, sigma = Online(both).run(z)
    assert_twins(signal, [step.filtered.mean for step in about.steps])
    assert_twins(sigma**2, [step.filtered.cov[0] for step in about.steps])


def test_a_gain_that_settles_late_is_the_full_recursion() -> None:
    """The IMU paper's form of a gyroscope, with Q / R = 1e4: closed-loop poles 0.905 and 0.999 at 1 kHz.

    The slow state's gain comes from 1/50 of what it is measured by, as equations (2) to (7) say.
    """
    T = 1e-3
    model = Model(
        np.array([[1, T], [0, 1]]), [[1, 0]], np.eye(2), [[1e-4]], G=T * np.eye(2), x0=[0, 0], P0=np.ones((2, 2))
    )
    z = 1e-3 * drawn(model, 18_000)
    means, spread, belief = (
        np.empty((len(z), 2)),
        np.empty((len(z), 1)),
        reference.StateEstimate(np.zeros(2), np.ones((2, 2))),
    )
    for k, reading in enumerate(z):
        before = reference.predict(belief, model.F, model.process_covariance) if k else belief
        belief = reference.update(before, model.H, model.R, reading).filtered
        means[k], spread[k] = belief.mean, belief.cov[0, 0]
    got = kalman_filter(model, z, states=True)
    assert got.settled_row is not None
    latest = settled_by(slowest_pole(model) ** 2, start=1 / 50)
    assert latest / 1.125 < got.settled_row <= latest + 256  # blocks are checked as a whole
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
    latest = int(settled_by(slowest_pole(model) ** 2)) + 3  # three checks in a row confirm it
    assert got.settled_row <= latest
    for begin, end in ((got.settled_row, 1024), (1034 + latest, 2048), (2049 + latest, 3072), (3073 + latest, 4000)):
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
    about = known(model, z)
    assert_filter(kalman_filter(model, z, states=True), about)
    assert_smoother(kalman_smoother(model, z, states=True), about)


CREEPING = Model([[1]], [[1]], [[1e-12]], [[1]], x0=[0], P0=[[1e-6]])  # half a millionth from the settled one
SETTLED_AND_SLOW = Model([[1]], [[1]], [[1e-12]], [[1]], x0=[0], P0=steady(CREEPING).predicted_cov)


@pytest.mark.parametrize("model", [CREEPING, SETTLED_AND_SLOW], ids=["P0 is near", "after a gap"])
@pytest.mark.parametrize("covariances", [False, True])
def test_a_gain_that_creeps_has_not_settled(model: Model, covariances: bool) -> None:
    """A closed-loop pole of 1 - 1e-6: within 32 rows or 1000, what is far from settled moves by less than rounding."""
    z = drawn(model, 3000)
    if model is SETTLED_AND_SLOW:
        z[40] = np.nan
    about = known(model, z)
    assert_filter(kalman_filter(model, z, states=True, covariances=covariances), about)
    assert_smoother(kalman_smoother(model, z, states=True, covariances=covariances), about)
    assert_online(about, z)


@pytest.mark.parametrize("bursts", [19, 20, 21, 58])  # of every remainder by three, and many
def test_a_gain_that_is_the_same_after_every_gap_has_not_settled(bursts: int) -> None:
    """Bursts of 40 readings, gaps of 460: every burst ends as the one before, and no gain is the settled one."""
    model = Model([[1]], [[1]], [[1e-4]], [[1]], x0=[0], P0=[[1]])
    z = drawn(model, 500 * bursts + 4000)
    for begin in range(0, 500 * bursts, 500):
        z[begin : begin + 460] = np.nan
    about = known(model, z, smooth=False)
    assert_filter(kalman_filter(model, z, states=True), about)
    assert_online(about, z)


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
    assert_right(model, z, corrected=True)
