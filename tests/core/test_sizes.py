"""Every size of model: each is the reference, in blocks, across gaps, at any scale."""

from __future__ import annotations

from functools import cache
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest

from against_reference import TWIN, Known, assert_filter, assert_online, assert_smoother, assert_twins, known
from becalm.core.arrays import Floats
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.likelihood import log_likelihood
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.model import Model
from becalm.core.online import Online

ROWS = 1500
QUICK = [(1, 1), (2, 1), (3, 1), (4, 1), (1, 3), (2, 2), (4, 2)]  # one channel and up to four states look ahead
LARGE = [(5, 1), (2, 3)]
PAIRS = [*QUICK, *(pytest.param(pair, marks=pytest.mark.slow) for pair in LARGE)]


def covariance(rng: np.random.Generator, size: int) -> Floats:
    """Draw a covariance whose channels are correlated."""
    A = rng.normal(size=(size, size))
    drawn: Floats = A @ A.T / size + 0.3 * np.eye(size)
    return drawn


def model_of(n: int, m: int) -> Model:
    """Draw a model that settles within 256 rows."""
    rng = np.random.default_rng(100 * n + m)
    F = np.linalg.qr(rng.normal(size=(n, n)))[0] @ np.diag(np.linspace(0.6, 0.97, n)) + 0.02 * rng.normal(size=(n, n))
    F *= 0.95 / max(0.95, np.abs(np.linalg.eigvals(F)).max())
    H = rng.normal(size=(m, n))
    return Model(F, H, 0.2 * covariance(rng, n), covariance(rng, m), x0=rng.normal(size=n), P0=2 * covariance(rng, n))


@cache
def record(pair: tuple[int, int], damaged: bool) -> tuple[Known, Floats]:
    """Draw readings as large as the model expects, and lose some of them; the reference is slow, so once."""
    model = model_of(*pair)
    z = 2 * np.random.default_rng(7).normal(size=(ROWS, model.channels))
    if damaged:
        z[255], z[256, 0], z[511, -1] = np.nan, np.nan, np.nan
        z[700, :1], z[830:833], z[1290:, -1] = np.nan, np.nan, np.nan
    return known(model, z), z


@pytest.mark.parametrize("damaged", [False, True], ids=["whole", "damaged"])
@pytest.mark.parametrize("pair", PAIRS, ids=str)
class TestEverySize:
    """One model a size, correlated R, with and without covariances: they settle differently."""

    def test_the_filter_is_the_reference(self, pair: tuple[int, int], damaged: bool) -> None:
        about, z = record(pair, damaged)
        for covariances in (False, True):
            got = kalman_filter(about.model, z, states=True, covariances=covariances)
            assert got.settled_row is not None, "the gain never settled, so no block was tested"
            assert got.settled_row < 512
            assert_filter(got, about)
            assert log_likelihood(about.model, z) == pytest.approx(got.log_likelihood, rel=TWIN)

    def test_the_smoother_is_the_reference(self, pair: tuple[int, int], damaged: bool) -> None:
        about, z = record(pair, damaged)
        for covariances in (False, True):
            got = kalman_smoother(about.model, z, states=True, covariances=covariances)
            assert_smoother(got, about)
            ahead = kalman_filter(about.model, z, covariances=covariances)
            np.testing.assert_allclose(got.innovations, ahead.innovations, rtol=1e-12, atol=1e-12)
            assert got.log_likelihood == pytest.approx(ahead.log_likelihood, rel=TWIN)

    def test_online_is_the_reference(self, pair: tuple[int, int], damaged: bool) -> None:
        about, z = record(pair, damaged)
        assert_online(about, z)


FLAGS = ("states", "covariances", "sigma", "innovations")
RESULTS = {"mean": "states", "cov": "covariances", "sigma": "sigma", "innovations": "innovations"}


@pytest.mark.parametrize("run", [kalman_filter, kalman_smoother])
@pytest.mark.parametrize("pair", [(2, 1), (2, 2)], ids=str)
def test_what_is_wanted_does_not_change_what_comes(pair: tuple[int, int], run: Any) -> None:
    """Bit for bit where the path is the same; covariances settle later, which shows in the last digits."""
    about, z = record(pair, True)
    for covariances in (False, True):
        everything = run(about.model, z, states=True, covariances=covariances)
        for states, sigma, innovations in product((False, True), repeat=3):
            wanted = dict(zip(FLAGS, (states, covariances, sigma, innovations), strict=True))
            got = run(about.model, z, **wanted)
            assert np.array_equal(got.signal, everything.signal)
            assert got.log_likelihood == everything.log_likelihood
            assert (got.used, got.settled_row) == (everything.used, everything.settled_row)
            for name, flag in RESULTS.items():
                if wanted[flag]:
                    assert np.array_equal(getattr(got, name), getattr(everything, name), equal_nan=True), name
            assert (got.mean is None, got.cov is None) == (not states, not covariances)
            assert innovations or got.innovations.size == got.innovation_sigma.size == 0
            assert sigma or covariances or got.sigma.size == 0


def bits(results: tuple[Floats, Floats]) -> tuple[bytes, bytes]:
    return np.ascontiguousarray(results[0]).tobytes(), np.ascontiguousarray(results[1]).tobytes()


LONG = 5000
CUTS = [0, 1, 2, 31, 33, 200, 256, 257, 600, 1100, 1101, 1500, 1501, 3000, 4999, LONG]


@pytest.mark.parametrize("flat", [False, True], ids=["prior", "flat"])
@pytest.mark.parametrize("pair", [(1, 1), (3, 1), (2, 2), (4, 2)], ids=str)
class TestOnline:
    """A file and its stream, over settled stretches, gaps and pauses."""

    def record(self, pair: tuple[int, int], flat: bool) -> tuple[Model, Floats]:
        drawn = model_of(*pair)
        z = 2 * np.random.default_rng(8).normal(size=(LONG, drawn.channels))
        z[1000:1100], z[1500, 0], z[2047:2050, -1], z[4000] = np.nan, np.inf, np.nan, 1e101
        return (Model(drawn.F, drawn.H, drawn.Q, drawn.R) if flat else drawn), z

    def test_a_file_is_its_stream(self, pair: tuple[int, int], flat: bool) -> None:
        model, z = self.record(pair, flat)
        expected = kalman_filter(model, z)
        told = np.flatnonzero(np.isfinite(expected.sigma).all(axis=1))
        assert told[0] < pair[0]
        assert len(told) == LONG - told[0]
        signal, sigma = Online(model).run(z)
        assert_twins(signal, expected.signal)
        assert_twins(sigma[told], expected.sigma[told])

    def test_any_chunks_are_the_same_bits(self, pair: tuple[int, int], flat: bool) -> None:
        model, z = self.record(pair, flat)
        whole = Online(model).run(z)
        online = Online(model)
        parts = [online.run(z[begin:end]) for begin, end in pairwise(CUTS)]
        assert bits((np.vstack([p[0] for p in parts]), np.vstack([p[1] for p in parts]))) == bits(whole)
        online = Online(model)
        rows = [online.step(row) for row in z]
        assert bits((np.array([r[0] for r in rows]), np.array([r[1] for r in rows]))) == bits(whole)
        if model.channels == 1:
            online = Online(model)
            numbers = np.array([online.step(number) for number in z[:, 0].tolist()])
            assert bits((numbers[:, :1], numbers[:, 1:])) == bits(whole)

    @pytest.mark.parametrize("cut", [1, 40, 700, 1050, 1100, 1120, 2500, 2501])
    def test_a_pause_in_a_settled_stretch_changes_no_bit(self, pair: tuple[int, int], flat: bool, cut: int) -> None:
        model, z = self.record(pair, flat)
        whole = Online(model).run(z)
        online = Online(model)
        before = online.run(z[:cut])
        resumed = Online.resume(online.snapshot())
        after = resumed.run(z[cut:])
        assert bits((np.vstack([before[0], after[0]]), np.vstack([before[1], after[1]]))) == bits(whole)
        online.run(z[cut:])
        assert resumed.snapshot() == online.snapshot()


PLAIN: dict[str, Any] = {
    "F": [[1, 0.5], [0, 0.95]],
    "H": [[1, 0], [0.5, 1]],
    "Q": np.diag([0.1, 0.2]),
    "R": [[1, 0.4], [0.4, 0.8]],
    "x0": [1, -1],
    "P0": 3 * np.eye(2),
}
NONE = np.zeros((2, 2))
DEGENERATE: dict[str, dict[str, Any]] = {
    "R = 0": {"R": NONE},
    "Q = 0": {"Q": NONE},
    "P0 = 0": {"P0": NONE},
    "P0 of ones": {"P0": np.ones((2, 2))},
    "Q = 0, P0 = 0": {"Q": NONE, "P0": NONE},
    "R = 0, P0 = 0": {"R": NONE, "P0": NONE},
    "R of ones": {"R": np.ones((2, 2))},
    "one channel exact": {"R": np.diag([0.0, 1.0])},
    "Q of rank one": {"Q": np.ones((2, 2))},
    "no P0, one state still": {"Q": np.diag([0.0, 1.0]), "P0": np.diag([0.0, 1.0])},
}


def scaled(factor: float, changes: dict[str, Any]) -> Model:
    matrices = PLAIN | changes
    variances_too = {name: factor**2 * np.asarray(matrices[name]) for name in ("Q", "R", "P0")}
    return Model(**matrices | variances_too | {"x0": factor * np.asarray(matrices["x0"])})


SCALES = [case for k, name in enumerate(DEGENERATE) for case in ((name, 1.0), (name, (1e-30, 1e30)[k % 2]))]
"""Each as it is, and much smaller or larger by turns."""


@pytest.mark.parametrize(("name", "factor"), SCALES, ids=str)
def test_degenerate_noise_and_any_scale(name: str, factor: float) -> None:
    model = scaled(factor, DEGENERATE[name])
    z = factor * np.random.default_rng(9).normal(size=(1000, 2))
    z[600:610] = np.nan
    about = known(model, z)
    for covariances in (False, True):
        got = kalman_filter(model, z, states=True, covariances=covariances)
        back = kalman_smoother(model, z, states=True, covariances=covariances)
        assert_filter(got, about, scale=factor**2)
        assert_smoother(back, about, scale=factor**2)
    signal = Online(model).run(z)[0]
    assert_twins(signal, [model.H @ step.filtered.mean for step in about.steps])
