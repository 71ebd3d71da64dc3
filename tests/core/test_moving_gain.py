"""Covariances of a gain that still moves, against `core.reference`, where they are hard to keep.

Records here go on from x0 and P0: their first row follows a step as well.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import WantedResults, run_filter
from becalm.core.filter.smoothing import run_smoother
from becalm.core.model.components import motion
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import Timeline, elapsed_timeline, model_system
from becalm.core.reference import kalman as reference

TWIN = 1e-12
BLOCK, ROWS = 256, 4 * 256 + 50


def going_on(model: Model, count: int) -> Timeline:
    """Give every row the model's own step, the first as well."""
    return Timeline(model_system(model), np.array([0, count]), np.array([0]), np.ones(1))


def start_of(model: Model) -> reference.StateEstimate:
    assert model.x0 is not None and model.P0 is not None  # noqa: PT018
    return reference.StateEstimate(model.x0, model.P0)


class Told(NamedTuple):
    """What the reference says of a record."""

    steps: list[reference.ReferenceStep]
    beliefs: list[reference.StateEstimate]  # smoothed


def filtered(model: Model, timeline: Timeline, z: Floats) -> list[reference.ReferenceStep]:
    """Filter with the reference's own equations, each row after the step of the timeline."""
    belief, steps = start_of(model), []
    for row, reading in enumerate(z):
        k = timeline.step_before(row)
        before = reference.predict(belief, timeline.system.F[k], timeline.system.Q[k])
        steps.append(reference.update(before, model.H, model.R, reading))
        belief = steps[-1].filtered
    return steps


def followed(model: Model, timeline: Timeline, z: Floats) -> Told:
    """Filter and smooth a record of even steps with the reference."""
    steps = filtered(model, timeline, z)
    return Told(steps, reference.smooth(steps, model.F, model.H))


def assert_twins(got: Floats | None, expected: Any, measure: Any = None, bound: float = TWIN) -> None:
    """Agree to 1e-12 of each component's largest value, or that of what it is a difference of; NaN where NaN."""
    assert got is not None
    expected = np.asarray(expected).reshape(got.shape)
    size = np.nanmax(np.abs(expected if measure is None else np.asarray(measure)), axis=0, initial=0.0)
    assert np.array_equal(np.isnan(got), np.isnan(expected))
    assert np.nanmax(np.abs(got - expected) - bound * size, initial=0.0) <= 0


def assert_each(got: Floats, expected: Any, bound: float = TWIN) -> None:
    """Agree to 1e-12 of every single value: a variance is never small by cancellation."""
    np.testing.assert_allclose(got, np.asarray(expected).reshape(got.shape), rtol=bound, atol=0)


def variances(H: Floats, covs: list[Floats]) -> Floats:
    return np.array([np.diag(H @ P @ H.T) for P in covs])


def assert_filter(model: Model, timeline: Timeline, z: Floats, told: Told, bound: float = TWIN) -> None:
    run, H, steps = run_filter(model, timeline, z, WantedResults(states=True)), model.H, told.steps
    got, there = run.estimate, np.isfinite(z[:, 0])
    S = [step.innovation_cov[0] for step in steps if len(step.innovation_cov)]
    means = [step.filtered.mean for step in steps]
    assert_twins(got.signal, [H @ mean for mean in means], None, bound)
    assert_twins(got.mean, means, None, bound)
    assert_twins(got.innovations, [step.innovation for step in steps], z, bound)
    assert_each(got.sigma**2, variances(H, [step.filtered.cov for step in steps]), bound)
    assert_each(got.innovation_sigma[there] ** 2, S, bound)
    assert np.isnan(got.innovation_sigma[~there]).all()
    last = steps[-1].filtered.cov
    off, spread = np.abs(run.cov - last), np.sqrt(np.diag(last))
    assert (off <= bound * spread * spread[:, np.newaxis]).all()
    assert got.log_likelihood == pytest.approx(sum(step.log_likelihood for step in steps), rel=bound)
    assert got.used == there.sum()


def assert_smoother(model: Model, timeline: Timeline, z: Floats, told: Told, bound: float = TWIN) -> None:
    H, covs = model.H, [step.filtered.cov for step in told.steps]
    means, before = [belief.mean for belief in told.beliefs], [step.filtered.mean for step in told.steps]
    for states in (False, True):
        got = run_smoother(model, timeline, z, WantedResults(states=states))
        assert_twins(got.signal, [H @ mean for mean in means], None, bound)
        assert_twins(got.sigma**2, variances(H, [belief.cov for belief in told.beliefs]), variances(H, covs), bound)
    assert_twins(got.mean, means, means + before, bound)


def moving(order: int, q: float, P0: float, R: float = 1.0) -> Model:
    """A motion of one channel whose q and P0 are measured by R."""
    at = motion(order, q).to_model(1.0, 1.0)
    return Model(at.F, at.H, R * at.Q, [[R]], x0=np.zeros(order), P0=R * P0 * np.eye(order))


def scaled(model: Model, factors: list[float]) -> Model:
    """The same signal in other units of its states."""
    D, back, P0 = np.diag(factors), np.diag(1 / np.array(factors)), start_of(model).cov
    Q = D @ model.process_covariance @ D
    return Model(D @ model.F @ back, model.H @ back, Q, model.R, x0=np.zeros(len(D)), P0=D @ P0 @ D)


def pair(F: Any, H: Any, q: list[float], P0: Floats) -> Model:
    return Model(F, H, np.diag(q), 1.0, x0=[0, 0], P0=P0)


# the paper's, at 10 kHz: closed-loop poles 0.9 and 0.9999, so that it settles after 147 201 rows only
GYROSCOPE = Model(
    np.eye(2) + 1e-4 * np.eye(2, k=1), [[1, 0]], 1.9674e-15 * np.eye(2), 1.9148e-10, None, [0, 0], 1e-6 * np.eye(2)
)
TURN: list[list[float]] = [[0.995, -0.0998], [0.0998, 0.995]]
SLOW = moving(3, 1e-14, 1e-3)
CASES = {
    "gyroscope": GYROSCOPE,  # P0 is 5000 R
    "level": moving(1, 1e-9, 1.0),
    "level, P0 = 0": moving(1, 1e-9, 0.0),
    "level, Q = 0": moving(1, 0.0, 1.0),
    "level, gain of 0.95": moving(1, 20.0, 1.0),
    "level, gain of 0.98 is too much": moving(1, 70.0, 0.0),
    "slope": moving(2, 1e-10, 1e-2),
    "slope, R tiny": moving(2, 1e-10, 1e-2, 1e-150),
    "slope, R huge": moving(2, 1e-10, 1e-2, 1e150),
    "acceleration": SLOW,
    "acceleration, units 1e8 apart": scaled(SLOW, [1.0, 1e8, 1e-8]),
    "jerk": moving(4, 1e-14, 1e-3),  # P0 lets the level run far within the first block
    "jerk, units 1e8 apart": scaled(moving(4, 1e-14, 1e-3), [1e8, 1.0, 1e-8, 1e4]),
    "jerk, P0 = 0": moving(4, 1e-14, 0.0),
    "oscillator": Model(TURN, [[1, 0.5]], 1e-9 * np.eye(2), 1.0, x0=[1, 0], P0=np.eye(2)),
    "never observed": pair([[1, 1e-4], [0, 1]], [[0, 1]], [1e-8, 1e-8], np.ones((2, 2))),
    "never observed, unstable": pair([[1.02, 0], [0, 1]], [[0, 1]], [1, 1e-6], np.eye(2)),
    "never observed, unstable, fed": pair([[1.02, 1], [0, 1]], [[0, 1]], [1, 1e-6], np.eye(2)),
    "unstable, observed": pair([[1.02, 0.1], [0, 0.9]], [[1, 0]], [1e-6, 1e-6], np.zeros((2, 2))),
    "R = 0": Model(0, 1, 1, 0.0, None, [0], 1),
    "R next to 0": Model(0, 1, 1, 1e-300, None, [0], 1),
    "of rank one": pair([[1, 0.1], [0, 0.99]], [[1, -1]], [0, 0], 0.1 * np.ones((2, 2))),
}


@cache
def record(name: str, damaged: bool) -> tuple[Model, Timeline, Floats, Told]:
    """Draw readings as large as R, and lose some of them; the reference is slow, so once."""
    model = CASES[name]
    z = np.sqrt(model.R[0, 0] or 1.0) * np.random.default_rng(3).normal(size=(ROWS, 1))
    if damaged:
        z[[BLOCK - 1, 2 * BLOCK - 1]], z[3 * BLOCK + 2 : 3 * BLOCK + 40], z[4 * BLOCK] = np.nan, np.nan, np.nan
    return model, going_on(model, ROWS), z, followed(model, going_on(model, ROWS), z)


@pytest.mark.parametrize("damaged", [False, True], ids=["whole", "damaged"])
@pytest.mark.parametrize("name", CASES)
class TestEveryCase:
    """Damaged: a reading is missing at the end of the first two blocks, so that nothing settles before the third."""

    def test_the_filter_is_the_reference(self, name: str, damaged: bool) -> None:
        assert_filter(*record(name, damaged))

    def test_the_smoother_is_the_reference(self, name: str, damaged: bool) -> None:
        assert_smoother(*record(name, damaged))


@pytest.mark.parametrize("P0", [1e-9, 1.0, 7.9, 8.1, 1e8])
def test_a_level_that_stands_still_is_known_as_its_mean_is(P0: float) -> None:
    """Without Q the variance after k readings is 1 / (1 / P0 + k); eight readings may tell 64 times what is left."""
    model, z = moving(1, 0.0, P0), np.random.default_rng(8).normal(size=(BLOCK, 1))
    got, told = run_filter(model, going_on(model, BLOCK), z).estimate, 1 / P0 + np.arange(1, BLOCK + 1)
    assert_each(got.sigma**2, 1 / told, 2e-14)
    assert_each(got.innovation_sigma**2, 1 + 1 / (1 / P0 + np.arange(BLOCK)), 2e-14)
    assert_twins(got.signal, np.cumsum(z) / told)


def test_steps_of_several_lengths_and_blocks_within_them() -> None:
    """Steps of 1, of 0.5, and of 1 again, and gaps between them."""
    component = motion(3, 1e-12)
    elapsed: Floats = np.concatenate([np.ones(600), np.full(900, 0.5), [40.0, 0.0, 3.0], np.ones(700)])
    model = moving(3, 1e-12, 1e-4)
    timeline = elapsed_timeline(component, 1.0, elapsed, continues=True)
    z = np.random.default_rng(5).normal(size=(len(elapsed), 1))
    z[1100], z[1791:1795] = np.nan, np.nan
    got, singly = (run_smoother(model, timeline, z, WantedResults(covariances=asked)) for asked in (False, True))
    assert got.settled_row is None
    assert_filter(model, timeline, z, Told(filtered(model, timeline, z), []))
    assert_twins(got.signal, singly.signal)
    assert_twins(got.sigma**2, singly.sigma**2, run_filter(model, timeline, z).estimate.sigma ** 2)


POLES = st.sampled_from([1.0, 0.99, 0.9, 0.5, 0.0, -0.5, -0.95])
POWERS = st.integers(-12, 0)
CLOSE = 1e-11  # modes as near as 1 and 0.99 share a signal, and rounding is shared out among them
TAIL = 31  # rows: too few for the gain to settle, which keeps fewer digits of a sigma


@given(
    poles=st.lists(POLES, min_size=1, max_size=4, unique=True),
    powers=st.tuples(POWERS, POWERS, st.integers(-60, 60)),
    units=st.lists(st.integers(-8, 8), min_size=4, max_size=4),
    lost=st.none() | st.integers(0, TAIL - 1),
    mixed=st.booleans(),
)
@example(poles=[1.0, 0.99, 0.9, 0.5], powers=(-8, 0, 0), units=[8, -8, 8, -8], lost=None, mixed=True)
@example(poles=[1.0], powers=(-12, -6, 0), units=[0, 0, 0, 0], lost=None, mixed=False)
@example(poles=[0.9, 0.5, 0.0, -0.95], powers=(-9, -7, 0), units=[0, 0, 0, 0], lost=None, mixed=True)
@settings(max_examples=40)
def test_any_model(poles: Any, powers: Any, units: Any, lost: int | None, mixed: bool) -> None:
    """Modes of any pace, alone or each fed by the next, in any units; the rows after a block show what it left."""
    n, (q, p, r) = len(poles), powers
    D, R = 10.0 ** np.array(units[:n]), 10.0**r
    F = (np.diag(poles) + (0.1 * np.eye(n, k=1) if mixed else 0)) * D[:, np.newaxis] / D
    noise = R * np.diag(D**2)
    model = Model(F, 1 / D[np.newaxis], 10.0**q * noise, R, x0=np.zeros(n), P0=10.0**p * noise)
    z = np.sqrt(R) * np.random.default_rng(7).normal(size=(BLOCK + TAIL, 1))
    if lost is not None:
        z[BLOCK + lost] = np.nan
    timeline = going_on(model, len(z))
    told = followed(model, timeline, z)
    assert_filter(model, timeline, z, told, CLOSE)
    assert_smoother(model, timeline, z, told, CLOSE)


LIMITS = {
    "what is lost grows within the block": Model(3.0, 1.0, 0.0, 1.0, None, [0], 1e-6),
    "and leaves nothing": Model(10.0, 1.0, 0.0, 1.0, None, [0], 1e-20),
    "two slow poles beside a fast one": Model(
        np.diag([1, 1 - 1e-8, 0.9]), [[1, 1, 1]], np.zeros((3, 3)), 1.0, x0=np.zeros(3), P0=np.eye(3)
    ),
    "information beyond any number, R tiny": Model(1.0, 1.0, 0.0, 3e-308, None, [0], 3e-308),
    "information beyond any number, H huge": Model(20.0, 1e135, 0.0, 1.0, None, [0], 1e-304),
}


@pytest.mark.parametrize("covariances", [True, False])
@pytest.mark.parametrize("name", LIMITS)
def test_what_leaves_the_range_of_squares(name: str, covariances: bool) -> None:
    model = LIMITS[name]
    z = np.sqrt(model.R[0, 0]) * np.random.default_rng(9).normal(size=(BLOCK, 1))
    steps = filtered(model, going_on(model, BLOCK), z)
    got = run_filter(model, going_on(model, BLOCK), z, WantedResults(covariances=covariances)).estimate
    assert_each(got.innovation_sigma**2, [step.innovation_cov for step in steps])
    assert_each(got.sigma**2, variances(model.H, [step.filtered.cov for step in steps]))
