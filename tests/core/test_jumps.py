"""Leaps through the covariances of a moving gain, against `core.reference`, where they are hard to keep.

Records here go on from x0 and P0: their first row follows a step as well, so that the first block leaps
from P0. Where covariances are asked for all rows are taken one by one; so the last digits tell what leaps.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from becalm.core import reference
from becalm.core.arrays import Floats
from becalm.core.components import motion
from becalm.core.filtering import Wanted, run_filter
from becalm.core.model import Model
from becalm.core.smoothing import run_smoother
from becalm.core.timeline import Timeline, elapsed_timeline, model_system

TWIN = 1e-12
BLOCK, ROWS = 256, 4 * 256 + 50


def going_on(model: Model, count: int) -> Timeline:
    """Give every row the model's own step, the first as well."""
    return Timeline(model_system(model), np.array([0, count]), np.array([0]), np.ones(1))


def start_of(model: Model) -> reference.Belief:
    assert model.x0 is not None and model.P0 is not None  # noqa: PT018
    return reference.Belief(model.x0, model.P0)


class Told(NamedTuple):
    """What the reference says of a record."""

    steps: list[reference.Step]
    beliefs: list[reference.Belief]  # smoothed


def filtered(model: Model, timeline: Timeline, z: Floats) -> list[reference.Step]:
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
    run, H, steps = run_filter(model, timeline, z, Wanted(states=True)), model.H, told.steps
    got, there = run.estimate, np.isfinite(z[:, 0])
    S = [step.innovation_cov[0] for step in steps if len(step.innovation_cov)]
    means = [step.filtered.mean for step in steps]
    assert_twins(got.signal, [H @ mean for mean in means], None, bound)
    assert_twins(got.mean, means, None, bound)
    assert_twins(got.innovations, [step.innovation for step in steps], z, bound)
    assert_each(got.sigma**2, variances(H, [step.filtered.cov for step in steps]), bound)
    assert_each(got.innovation_sigma[there] ** 2, S, bound)
    assert np.isnan(got.innovation_sigma[~there]).all()
    last, n = steps[-1].filtered.cov, model.states
    off, spread = np.abs(run.memory[0, n : n + n * n].reshape(n, n) - last), np.sqrt(np.diag(last))
    assert (off <= bound * spread * spread[:, np.newaxis]).all()
    assert got.log_likelihood == pytest.approx(sum(step.log_likelihood for step in steps), rel=bound)
    assert got.used == there.sum()


def assert_smoother(model: Model, timeline: Timeline, z: Floats, told: Told, bound: float = TWIN) -> None:
    """Without states it goes back through whole blocks, with them row by row."""
    H, covs = model.H, [step.filtered.cov for step in told.steps]
    means, before = [belief.mean for belief in told.beliefs], [step.filtered.mean for step in told.steps]
    for states in (False, True):
        got = run_smoother(model, timeline, z, Wanted(states=states))
        assert_twins(got.signal, [H @ mean for mean in means], None, bound)
        assert_twins(got.sigma**2, variances(H, [belief.cov for belief in told.beliefs]), variances(H, covs), bound)
    assert_twins(got.mean, means, means + before, bound)


def leaps(model: Model, before: reference.Belief, z: Floats) -> bool:
    """Whether a block leaps from a belief: its last digits are not those of rows taken one by one.

    In the first 32 rows, before a gain can have settled, which would show as well.
    """
    (x, P), line = before, going_on(model, BLOCK)
    start = Model(model.F, model.H, model.process_covariance, model.R, x0=x, P0=(P + P.T) / 2)
    quick, singly = (run_filter(start, line, z, Wanted(covariances=asked)).estimate for asked in (False, True))
    names = ("sigma", "innovations", "innovation_sigma")
    return any(not np.array_equal(getattr(quick, name)[:32], getattr(singly, name)[:32], True) for name in names)


def blocks_that_leap(model: Model, told: Told, z: Floats) -> list[int]:
    """Return the whole blocks of a record of even steps that leap unless the gain has settled."""
    before = [start_of(model), *(step.filtered for step in told.steps)]
    blocks = range(len(z) // BLOCK)
    return [k for k in blocks if leaps(model, before[k * BLOCK], z[k * BLOCK :][:BLOCK])]


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


class Case(NamedTuple):
    """A model, and from which of the first four blocks it leaps."""

    model: Model
    leaping: tuple[int, ...] = (0, 1, 2, 3)


# the paper's, at 10 kHz: closed-loop poles 0.9 and 0.9999, so that it settles after 147 201 rows only
GYROSCOPE = Model(
    np.eye(2) + 1e-4 * np.eye(2, k=1), [[1, 0]], 1.9674e-15 * np.eye(2), 1.9148e-10, None, [0, 0], 1e-6 * np.eye(2)
)
TURN: list[list[float]] = [[0.995, -0.0998], [0.0998, 0.995]]
SLOW = moving(3, 1e-14, 1e-3)
CASES = {
    "gyroscope": Case(GYROSCOPE, (1, 2, 3)),  # P0 is 5000 R
    "level": Case(moving(1, 1e-9, 1.0)),
    "level, P0 = 0": Case(moving(1, 1e-9, 0.0)),
    "level, Q = 0": Case(moving(1, 0.0, 1.0)),
    "level, gain of 0.95": Case(moving(1, 20.0, 1.0)),
    "level, gain of 0.98 is too much": Case(moving(1, 70.0, 0.0), ()),
    "slope": Case(moving(2, 1e-10, 1e-2)),
    "slope, R tiny": Case(moving(2, 1e-10, 1e-2, 1e-150)),
    "slope, R huge": Case(moving(2, 1e-10, 1e-2, 1e150)),
    "acceleration": Case(SLOW),
    "acceleration, units 1e8 apart": Case(scaled(SLOW, [1.0, 1e8, 1e-8])),
    "jerk": Case(moving(4, 1e-14, 1e-3), (1, 2, 3)),  # P0 lets the level run far within the first block
    "jerk, units 1e8 apart": Case(scaled(moving(4, 1e-14, 1e-3), [1e8, 1.0, 1e-8, 1e4]), (1, 2, 3)),
    "jerk, P0 = 0": Case(moving(4, 1e-14, 0.0)),
    "oscillator": Case(Model(TURN, [[1, 0.5]], 1e-9 * np.eye(2), 1.0, x0=[1, 0], P0=np.eye(2))),
    "never observed": Case(pair([[1, 1e-4], [0, 1]], [[0, 1]], [1e-8, 1e-8], np.ones((2, 2)))),
    "never observed, unstable": Case(pair([[1.02, 0], [0, 1]], [[0, 1]], [1, 1e-6], np.eye(2))),
    "never observed, unstable, fed": Case(pair([[1.02, 1], [0, 1]], [[0, 1]], [1, 1e-6], np.eye(2))),
    "unstable, observed": Case(pair([[1.02, 0.1], [0, 0.9]], [[1, 0]], [1e-6, 1e-6], np.zeros((2, 2)))),
    "R = 0": Case(Model(0, 1, 1, 0.0, None, [0], 1), ()),
    "R next to 0": Case(Model(0, 1, 1, 1e-300, None, [0], 1), ()),
    "of rank one": Case(pair([[1, 0.1], [0, 0.99]], [[1, -1]], [0, 0], 0.1 * np.ones((2, 2)))),
}


@cache
def record(name: str, damaged: bool) -> tuple[Model, Timeline, Floats, Told]:
    """Draw readings as large as R, and lose some of them; the reference is slow, so once."""
    model = CASES[name].model
    z = np.sqrt(model.R[0, 0] or 1.0) * np.random.default_rng(3).normal(size=(ROWS, 1))
    if damaged:
        z[[BLOCK - 1, 2 * BLOCK - 1]], z[3 * BLOCK + 2 : 3 * BLOCK + 40], z[4 * BLOCK] = np.nan, np.nan, np.nan
    return model, going_on(model, ROWS), z, followed(model, going_on(model, ROWS), z)


@pytest.mark.parametrize("damaged", [False, True], ids=["whole", "damaged"])
@pytest.mark.parametrize("name", CASES)
class TestEveryCase:
    """Damaged: a reading is missing at the end of the first two blocks, so that the third one leaps unsettled."""

    def test_the_filter_is_the_reference(self, name: str, damaged: bool) -> None:
        (model, timeline, z, told), whole = record(name, damaged), (2,) if damaged else (0, 1, 2, 3)
        assert blocks_that_leap(model, told, z) == [block for block in CASES[name].leaping if block in whole]
        assert_filter(model, timeline, z, told)

    def test_the_smoother_is_the_reference(self, name: str, damaged: bool) -> None:
        assert_smoother(*record(name, damaged))


@pytest.mark.parametrize(("P0", "leaping"), [(1e-9, True), (1.0, True), (7.9, True), (8.1, False), (1e8, False)])
def test_a_level_that_stands_still_is_known_as_its_mean_is(P0: float, leaping: bool) -> None:
    """Without Q the variance after k readings is 1 / (1 / P0 + k); eight readings may tell 64 times what is left."""
    model, z = moving(1, 0.0, P0), np.random.default_rng(8).normal(size=(BLOCK, 1))
    assert leaps(model, start_of(model), z) == leaping
    got, told = run_filter(model, going_on(model, BLOCK), z).estimate, 1 / P0 + np.arange(1, BLOCK + 1)
    assert_each(got.sigma**2, 1 / told, 2e-14)
    assert_each(got.innovation_sigma**2, 1 + 1 / (1 / P0 + np.arange(BLOCK)), 2e-14)
    assert_twins(got.signal, np.cumsum(z) / told)


@pytest.mark.parametrize("P0", [1e2, 1e5, 1e8])
@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_a_wide_covariance_does_not_leap(order: int, P0: float) -> None:
    """Eight readings tell nearly all: what is left of so much would be rounding."""
    model = moving(order, 1e-10, P0)
    z = np.random.default_rng(order).normal(size=(BLOCK, 1))
    assert not leaps(model, start_of(model), z)
    assert leaps(model, start_of(moving(order, 1e-6, 100.0**-order)), z)


def test_steps_of_several_lengths_and_blocks_within_them() -> None:
    """Blocks that leap after steps of 1, of 0.5, and of 1 again; the others hold a change of step or a gap."""
    component = motion(3, 1e-12)
    elapsed: Floats = np.concatenate([np.ones(600), np.full(900, 0.5), [40.0, 0.0, 3.0], np.ones(700)])
    model = moving(3, 1e-12, 1e-4)
    timeline = elapsed_timeline(component, 1.0, elapsed, goes_on=True)
    z = np.random.default_rng(5).normal(size=(len(elapsed), 1))
    z[1100], z[1791:1795] = np.nan, np.nan
    got, singly = (run_smoother(model, timeline, z, Wanted(covariances=asked)) for asked in (False, True))
    assert got.settled_row is None
    assert not np.array_equal(got.innovation_sigma, singly.innovation_sigma)
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


@pytest.mark.parametrize("singly", [True, False], ids=["row by row", "leaping"])
@pytest.mark.parametrize("name", LIMITS)
def test_what_leaps_could_not_hold(name: str, singly: bool) -> None:
    model = LIMITS[name]
    z = np.sqrt(model.R[0, 0]) * np.random.default_rng(9).normal(size=(BLOCK, 1))
    steps = filtered(model, going_on(model, BLOCK), z)
    got = run_filter(model, going_on(model, BLOCK), z, Wanted(covariances=singly)).estimate
    assert_each(got.innovation_sigma**2, [step.innovation_cov for step in steps])
    assert_each(got.sigma**2, variances(model.H, [step.filtered.cov for step in steps]))
