"""The fast paths: settled gains in blocks, what ends them and what comes after, against `core.reference`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.lib.stride_tricks import as_strided

from against_reference import (
    Known,
    arrived,
    assert_filter,
    assert_right,
    assert_smoother,
    drawn,
    known,
    settled_by,
    slowest_pole,
)
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import Estimate, WantedResults, kalman_filter, run_filter
from becalm.core.filter.smoothing import kalman_smoother, run_smoother
from becalm.core.model.components import motion
from becalm.core.model.model import Model
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.core.online import Online
from becalm.core.reference import kalman as reference

SLOPE: dict[str, Any] = {"F": [[0.95, 0.5], [0, 0.9]], "H": [[1, 0]], "Q": [[0.1, 0], [0, 0.2]], "R": [[1]]}
PAIR: dict[str, Any] = SLOPE | {"H": [[1, 0], [0.5, 1]], "R": [[1, 0.4], [0.4, 0.8]]}
PRIOR: dict[str, Any] = {"x0": [1, -1], "P0": 3 * np.eye(2)}
MODELS = {"one channel": Model(**SLOPE, **PRIOR), "two channels": Model(**PAIR, **PRIOR)}
ROWS = 1100
EDGES = st.sampled_from([0, 1, 254, 255, 256, 257, 510, 511, 512, 513, 767, 768, 1023, 1024, ROWS - 1])
SPOILT = st.tuples(
    EDGES | st.integers(0, ROWS - 1), st.integers(0, 1), st.sampled_from([np.nan, np.inf, -np.inf, 1e101])
)
GAPS = st.tuples(EDGES | st.integers(0, ROWS - 1), st.sampled_from([1, 2, 30, 255, 256, 257, 600]), st.integers(-1, 1))


@pytest.mark.parametrize("name", MODELS)
@example(spoilt=[], gaps=[(445, 1, 0), (510, 1, 0)])  # two losses that end alike are no settled stretch
@given(spoilt=st.lists(SPOILT, max_size=4), gaps=st.lists(GAPS, max_size=3))
@settings(max_examples=15)
def test_whatever_does_not_arrive(name: str, spoilt: list[Any], gaps: list[Any]) -> None:
    model = MODELS[name]
    z = drawn(model, ROWS)
    for row, channel, value in spoilt:
        z[row, channel % model.channels] = value
    for row, length, channel in gaps:  # -1: all channels
        z[row : row + length, slice(None) if channel < 0 else channel % model.channels] = np.nan
    about = known(model, z)
    assert_filter(kalman_filter(model, z, states=True), about)
    assert_smoother(kalman_smoother(model, z, states=True), about)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("rows", [1, 2, 255, 256, 257, 511, 512, 513, 768])
def test_any_number_of_rows(name: str, rows: int) -> None:
    assert_right(MODELS[name], drawn(MODELS[name], rows))


@pytest.mark.parametrize("run", [kalman_filter, kalman_smoother])
def test_no_rows(run: Any) -> None:
    for model in (*MODELS.values(), Model(**SLOPE)):
        got = run(model, np.empty((0, model.channels)), states=True, covariances=True)
        assert [len(got.signal), len(got.sigma), len(got.mean), len(got.cov)] == [0, 0, 0, 0]
        assert (got.log_likelihood, got.used, got.settled_row) == (0.0, 0, None)


def rows_from(whole: Estimate, begin: int) -> Estimate:
    fields = ("signal", "sigma", "innovations", "innovation_sigma", "mean", "cov")
    return replace(whole, **{field: getattr(whole, field)[begin:] for field in fields})


@pytest.mark.parametrize("rows", [4, 255, 256, 257, 512, 1300])
def test_a_flat_start_goes_on_as_the_reference(rows: int) -> None:
    model = Model(**PAIR)
    z = drawn(model, rows)
    z[:2] = np.nan  # the third row tells both states; from there on the reference can follow
    got, back = (run(model, z, states=True, covariances=True) for run in (kalman_filter, kalman_smoother))
    assert got.mean is not None
    assert got.cov is not None
    after = z[2:].copy()
    after[0] = np.nan
    about = known(Model(**PAIR, x0=got.mean[2], P0=got.cov[2]), after)
    assert_filter(rows_from(got, 2), about)
    assert_smoother(rows_from(back, 2), about)
    assert np.isfinite(back.signal).all()


def spread_out(z: Floats) -> Floats:
    wide = np.full((2 * len(z), 3 * z.shape[1]), np.nan)
    wide[::2, ::3] = z
    return wide[::2, ::3]


def unaligned(z: Floats) -> Floats:
    room = np.zeros(z.nbytes + 1, dtype=np.uint8)[1:].view(np.float64).reshape(z.shape)
    room[:] = z
    return room


LAYOUTS: dict[str, Any] = {
    "read-only": lambda z: np.broadcast_to(z, z.shape),
    "Fortran": np.asfortranarray,
    "strided": spread_out,
    "backwards": lambda z: z[::-1].copy()[::-1],
    "unaligned": unaligned,
    "other endian": lambda z: z.astype(">f8"),
    "odd stride of one column": lambda z: as_strided(z, z.shape, (z.strides[0], 800)) if z.shape[1] == 1 else z,
    "float32": lambda z: z.astype(np.float32),
    "integers": lambda z: z.astype(np.int64),
    "lists": lambda z: z.tolist(),
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", MODELS)
def test_the_memory_layout_changes_no_bit(name: str, layout: str) -> None:
    model = MODELS[name]
    z = np.rint(10 * drawn(model, ROWS))  # whole numbers, so that every type holds them
    other = LAYOUTS[layout](z)
    before = np.array(other)
    for run in (kalman_filter, kalman_smoother):
        expected, got = run(model, z, states=True), run(model, other, states=True)
        for field in ("signal", "sigma", "mean", "innovations", "innovation_sigma"):
            assert np.array_equal(getattr(got, field), getattr(expected, field)), field
    assert np.array_equal(Online(model).run(other)[0], Online(model).run(z)[0])
    assert np.array_equal(np.array(other), before)


def followed(model: Model, F: Floats, Q: Floats, z: Floats) -> Known:
    """Filter and smooth with the reference's own steps, row k following F[k], Q[k]."""
    assert model.x0 is not None
    assert model.P0 is not None
    steps: list[reference.ReferenceStep] = []
    for k, reading in enumerate(z):
        start = reference.StateEstimate(model.x0, model.P0)
        belief = reference.predict(steps[-1].filtered, F[k], Q[k]) if steps else start
        steps.append(reference.update(belief, model.H, model.R, reading))
    smoothed, r, N = [], np.zeros(2), np.zeros((2, 2))
    for k in range(len(z) - 1, -1, -1):
        (x, P), nu = steps[k].filtered, steps[k].innovation
        smoothed.append(reference.StateEstimate(x + P @ r, P - P @ N @ P))
        H = model.H[np.isfinite(nu)]
        S_inverse = np.linalg.inv(steps[k].innovation_cov)
        A = np.eye(2) - steps[k].predicted.cov @ H.T @ S_inverse @ H
        r = F[k].T @ (H.T @ S_inverse @ nu[np.isfinite(nu)] + A.T @ r)  # (11)
        N = F[k].T @ (H.T @ S_inverse @ H + A.T @ N @ A) @ F[k]  # (12)
    return Known(model, steps, smoothed[::-1])


def test_uneven_time_between_even_stretches() -> None:
    """Two step lengths that settle, scattered steps, a long step, two readings at one time, gaps.

    The first even stretch lacks the last row of a block.
    """
    scattered = np.random.default_rng(4).uniform(0.5, 2, 50)
    parts = [np.ones(767), scattered, np.full(800, 1.25), np.full(1, 37.0), np.ones(600), np.zeros(1), np.ones(450)]
    elapsed: Floats = np.concatenate(parts)
    component = motion(2, 0.05)
    even = component.to_model(1.0, 1.0)
    model = Model(even.F, even.H, even.Q, even.R, x0=[0, 0], P0=np.eye(2))
    z = drawn(model, len(elapsed))
    z[900], z[1700:1760], z[2300] = np.nan, np.nan, 1e101
    about = followed(model, *component.over(elapsed), arrived(z))
    timeline = elapsed_timeline(component, 1.0, elapsed)
    wanted = WantedResults(states=True)
    got, back = run_filter(model, timeline, z, wanted).estimate, run_smoother(model, timeline, z, wanted)
    assert got.settled_row is not None
    assert got.settled_row <= settled_by(slowest_pole(model) ** 2) + 3  # three checks in a row confirm it
    assert_filter(got, about)
    assert_smoother(back, about)
