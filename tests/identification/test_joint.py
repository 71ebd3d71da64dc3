"""Q and R of several channels are found together, with honest errors, and what cannot be told is said."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from becalm.core.arrays import Floats
from becalm.core.filter.likelihood import log_likelihood
from becalm.core.model.components import autoregressive, motion
from becalm.core.model.model import Model
from becalm.errors import ModelError, RecordingError
from becalm.identification.several.joint import TunedModel, tune_model
from becalm.identification.several.matrices import Freedom

F, Q, R = np.array([[0.9, 0.0], [-0.3, 0.8]]), np.array([[2.0, -0.5], [-0.5, 1.0]]), np.diag([3.0, 2.0])
REST = {"x0": np.zeros(2), "P0": np.zeros((2, 2))}
T = 1 / 500
CAR = Model(
    F=np.array([[1, T, 0], [0, 1, 0], [0, 0, 1]]),
    G=[[T**2 / 2, 0], [T, 0], [0, T]],
    H=np.eye(3),
    Q=np.diag([1e5, 4e4]),
    R=np.diag([100.0, 50.0, 200.0]),
)


def with_covariances(model: Model, Q: Floats, R: Floats) -> Model:
    return Model(F=model.F, H=model.H, Q=Q, R=R, G=model.G, x0=model.x0, P0=model.P0)


def unknowing(model: Model) -> Model:
    """The same with Q and R far from the truth."""
    return with_covariances(model, np.eye(len(model.Q)), np.eye(len(model.R)))


PLANE = Model(F=F, H=np.eye(2), Q=Q, R=R, **REST)


def simulate(model: Model, count: int, seed: int) -> Floats:
    """Draw readings (N, m), from rest on."""
    rng = np.random.default_rng(seed)
    w = rng.multivariate_normal(np.zeros(len(model.Q)), model.Q, count) @ model.G.T
    v = rng.multivariate_normal(np.zeros(model.channels), model.R, count)
    x, power, reach = np.vstack([np.zeros((1, model.states)), w[:-1]]), model.F, 1
    while reach < count:  # each pass adds what comes from twice as far back
        x[reach:] += x[:-reach] @ power.T
        power, reach = power @ power, 2 * reach
    return np.asarray(x @ model.H.T + v)


def deviations(found: TunedModel, truth: Model) -> Floats:
    """Return the errors of the entries that were free, over their standard errors."""
    pairs = [
        (found.model.Q, found.process_error, truth.Q),
        (found.model.R, found.noise_error, truth.R),
    ]
    upper = [(np.triu(error) > 0, error, value - true) for value, error, true in pairs]
    return np.concatenate([(off[free] / error[free]) for free, error, off in upper])


RECORD = simulate(PLANE, 1001, seed=0)
FOUND = tune_model(unknowing(PLANE), RECORD, "full", "full")


def test_no_covariances_near_the_found_ones_are_likelier() -> None:
    """A thousandth of a standard error uphill is as far as rounding lets one look."""
    assert log_likelihood(FOUND.model, RECORD) == pytest.approx(FOUND.log_likelihood, rel=1e-12)
    rng = np.random.default_rng(1)
    for size in (1e-2, 0.1, 1.0):
        for _ in range(20):
            a, b = (size * rng.normal(size=(2, 2)) for _ in range(2))
            moved_q = FOUND.model.Q + FOUND.process_error * (a + a.T) / 2
            moved_r = FOUND.model.R + FOUND.noise_error * (b + b.T) / 2
            assert log_likelihood(with_covariances(PLANE, moved_q, moved_r), RECORD) <= FOUND.log_likelihood + 1e-6


def test_errors_are_those_of_the_curvature_in_the_entries_themselves() -> None:
    """Found in other coordinates, differences of the entries one by one give the same information."""
    at = np.array([(0, 0), (0, 1), (1, 1)])
    start = np.concatenate([FOUND.model.Q[*at.T], FOUND.model.R[*at.T]])
    errors = np.concatenate([FOUND.process_error[*at.T], FOUND.noise_error[*at.T]])

    def value(steps: Floats) -> float:
        entries = start + errors * steps
        new_q, new_r = (np.array([[e[0], e[1]], [e[1], e[2]]]) for e in (entries[:3], entries[3:]))
        return log_likelihood(with_covariances(PLANE, new_q, new_r), RECORD)

    ways, h = np.eye(6), 0.02
    information = np.array(
        [
            [sum(i * j * value(h * (i * a + j * b)) for i in (1, -1) for j in (1, -1)) / (-4 * h * h) for a in ways]
            for b in ways
        ]
    )
    np.testing.assert_allclose(np.sqrt(np.diag(np.linalg.inv(information))), 1.0, rtol=0.02)


def test_the_likelihood_is_that_of_one_big_gaussian() -> None:
    found = tune_model(unknowing(PLANE), RECORD[:60], "full", "full")
    noise_enters = np.zeros((120, 120))  # of each step's noise in each row's readings
    for i in range(60):
        for j in range(i):
            noise_enters[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = np.linalg.matrix_power(F, i - j - 1)
    cov = noise_enters @ np.kron(np.eye(60), found.model.Q) @ noise_enters.T + np.kron(np.eye(60), found.model.R)
    exact = multivariate_normal(np.zeros(120), cov).logpdf(RECORD[:60].ravel())
    assert found.log_likelihood == pytest.approx(exact, rel=1e-10)
    assert found.used == 120


def test_errors_cover_the_truth_as_they_promise() -> None:
    """68 % of 360 entries lie within one error: three binomial deviations are 8 %."""
    runs = [tune_model(unknowing(PLANE), simulate(PLANE, 1001, seed), "full", "full") for seed in range(60)]
    assert all(found.not_identifiable == () for found in runs)
    off = np.array([deviations(found, PLANE) for found in runs])
    assert off.shape == (60, 6)
    assert np.mean(np.abs(off) < 1) == pytest.approx(0.683, abs=0.08)
    assert np.abs(off).max() < 5
    assert off.std(axis=0) == pytest.approx(np.ones(6), abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("flat", [False, True])
def test_errors_cover_the_truth_of_the_car(flat: bool) -> None:
    """Three channels, two noises; 100 entries, three binomial deviations are 15 %."""
    known = {} if flat else {"x0": np.zeros(3), "P0": np.zeros((3, 3))}
    start = Model(F=CAR.F, G=CAR.G, H=CAR.H, Q=np.eye(2), R=np.eye(3), **known)
    off = np.array([deviations(tune_model(start, simulate(CAR, 2500, seed)), CAR) for seed in range(20)])
    assert off.shape == (20, 5)
    assert np.mean(np.abs(off) < 1) == pytest.approx(0.683, abs=0.15)
    assert np.abs(off).max() < 4.5


@pytest.mark.parametrize("flat", [False, True])
def test_missing_readings_are_left_out(flat: bool) -> None:
    start = Model(F=F, H=np.eye(2), Q=np.eye(2), R=np.eye(2), **({} if flat else REST))
    z = simulate(PLANE, 4000, seed=2)
    z[np.random.default_rng(3).random(z.shape) < 0.2] = np.nan
    z[:5], z[1000:1100, 1] = np.nan, np.nan
    before = z.copy()
    found = tune_model(start, z, "full", "full")
    assert np.array_equal(z, before, equal_nan=True)
    assert np.abs(deviations(found, PLANE)).max() < 4
    assert found.not_identifiable == ()
    assert np.isfinite(z).sum() - 6 <= found.used <= np.isfinite(z).sum() - (2 if flat else 0)
    longer = tune_model(start, np.vstack([z, np.full((100, 2), np.nan)]), "full", "full")
    np.testing.assert_allclose(longer.model.Q, found.model.Q, rtol=1e-4, atol=1e-5)
    assert longer.log_likelihood == pytest.approx(found.log_likelihood, rel=1e-9)


def test_what_is_known_before_any_reading_is_held() -> None:
    """That coloured noise is stationary: the likelihood that is told is that of the model that is returned."""
    given = (motion(1, 0.01) + autoregressive((0.8,), 1.0)).to_model(1.0, 0.5)
    assert given.known is not None
    z = np.random.default_rng(11).normal(size=400).cumsum()
    found = tune_model(given, z)
    assert found.model.known is not None
    np.testing.assert_array_equal(found.model.known, given.known)
    assert log_likelihood(found.model, z) == pytest.approx(found.log_likelihood, rel=1e-12)


@pytest.mark.parametrize("scale", [1e-9, 1e6])
def test_the_unit_does_not_matter(scale: float) -> None:
    other = tune_model(unknowing(PLANE), scale * RECORD, "full", "full")
    for now, then in [
        (other.model.Q, FOUND.model.Q),
        (other.model.R, FOUND.model.R),
        (other.process_error, FOUND.process_error),
    ]:
        np.testing.assert_allclose(now / scale**2, then, rtol=2e-3, atol=1e-3)


def test_channels_of_any_units_compare() -> None:
    """A channel in thousandths of a unit beside one in thousands."""
    units = np.array([1e3, 1e-3])
    other = Model(F=F, H=np.diag(units), Q=np.eye(2), R=np.eye(2), **REST)
    found = tune_model(other, RECORD * units, "full", "full")
    assert found.not_identifiable == ()
    np.testing.assert_allclose(found.model.Q, FOUND.model.Q, rtol=2e-3, atol=1e-3)
    np.testing.assert_allclose(found.model.R / np.outer(units, units), FOUND.model.R, rtol=2e-3, atol=1e-3)


@pytest.mark.parametrize("off", [1e-6, 1e4])
def test_where_the_search_begins_does_not_matter(off: float) -> None:
    """Far from the truth, and with half of the readings missing so that no moments point to it."""
    z = RECORD.copy()
    z[::2] = np.nan
    best = tune_model(PLANE, z)
    found = tune_model(with_covariances(PLANE, off * Q, R / off), z)
    assert found.log_likelihood == pytest.approx(best.log_likelihood, abs=1e-3)
    np.testing.assert_allclose(found.model.Q, best.model.Q, rtol=0.02)


def test_each_component_gets_one_scale() -> None:
    truth = Model(F=np.diag([0.95, 0.5]), H=[[1.0, 1.0]], Q=np.diag([0.04, 1.0]), R=[[0.5]])
    start = with_covariances(truth, np.eye(2), np.eye(1))
    found = tune_model(start, simulate(truth, 20_000, seed=4), "scale", "fixed")
    assert found.noise_error[0, 0] == 0.0
    assert found.model.R[0, 0] == 1.0
    joined = motion(2, 1.0).to_model(1.0, 1.0)
    z = simulate(with_covariances(joined, 0.01 * joined.Q, joined.R), 5000, seed=5)
    scaled = tune_model(joined, z, "scale")
    np.testing.assert_allclose(scaled.model.Q / joined.Q, scaled.model.Q[0, 0] / joined.Q[0, 0])
    np.testing.assert_allclose(scaled.process_error / scaled.model.Q, scaled.process_error[0, 0] / scaled.model.Q[0, 0])
    assert abs(scaled.model.Q[0, 0] - 0.01 * joined.Q[0, 0]) < 4 * scaled.process_error[0, 0]


@pytest.mark.parametrize("freedom", ["diagonal", "full", "scale"])
def test_noise_of_what_is_never_seen_is_not_identifiable(freedom: Freedom) -> None:
    """An accelerometer in a model that carries the velocity as well."""
    truth = Model(F=np.array([[1, T], [0, 1]]), H=[[0.0, 1.0]], Q=np.diag([1e-3, 4e-3]), R=[[1.0]])
    found = tune_model(truth, simulate(truth, 4000, seed=6), freedom)
    hidden = "the scale of Q[0]" if freedom == "scale" else "Q[0,0]"
    assert found.not_identifiable[0].startswith(f"{hidden} is not identifiable: the readings' autocovariances do not")
    assert len(found.not_identifiable) == (2 if freedom == "full" else 1)
    assert np.isinf(found.process_error[0, 0])
    assert found.model.Q[0, 0] == pytest.approx(1e-3)
    assert abs(found.model.Q[1, 1] - 4e-3) < 4 * found.process_error[1, 1]
    assert abs(found.model.R[0, 0] - 1.0) < 4 * found.noise_error[0, 0]


def test_unknowns_that_look_alike_are_named_with_the_reason() -> None:
    level = Model(F=[[0.0]], H=[[1.0]], Q=[[1.0]], R=[[1.0]], x0=[0.0], P0=[[1.0]])
    found = tune_model(level, np.random.default_rng(7).normal(size=500))
    assert len(found.not_identifiable) == 1
    assert "looks to the readings like +1 " in found.not_identifiable[0]
    assert "determine 1 of 2 unknowns" in found.not_identifiable[0]
    assert np.isinf([found.process_error, found.noise_error]).all()
    assert tune_model(level, 2 * np.random.default_rng(7).normal(size=500), "fixed").not_identifiable == ()


def test_a_channel_that_never_arrives_is_not_identifiable() -> None:
    """Its process noise still is, through the speed that it drives, if far less well."""
    z = simulate(CAR, 3000, seed=8)
    whole = tune_model(CAR, z)
    z[:, 1] = np.nan
    found = tune_model(CAR, z)
    assert [sentence[:24] for sentence in found.not_identifiable] == ["R[1,1] is not identifiab"]
    assert np.isinf(found.noise_error[1, 1])
    assert found.model.R[1, 1] == CAR.R[1, 1]
    assert np.isfinite([found.process_error[1, 1], found.noise_error[0, 0], found.noise_error[2, 2]]).all()
    assert 1.5 * whole.process_error[0, 0] < found.process_error[0, 0] < np.inf
    assert abs(found.model.Q[0, 0] - CAR.Q[0, 0]) < 4 * found.process_error[0, 0]


def test_channels_that_never_arrive_together_do_not_tell_their_correlation() -> None:
    z = simulate(PLANE, 3000, seed=9)
    z[::2, 0], z[1::2, 1] = np.nan, np.nan
    found = tune_model(unknowing(PLANE), z, "full", "full")
    assert [sentence[:6] for sentence in found.not_identifiable] == ["R[0,1]"]
    assert np.isinf(found.noise_error[0, 1])
    finite = np.isfinite(deviations(found, PLANE))
    assert np.abs(deviations(found, PLANE)[finite]).max() < 4


def test_a_noise_that_is_not_there_cannot_be_told_from_zero() -> None:
    """Its error then says how large it might be: there the log-likelihood has fallen by one half."""
    said = 0
    for seed in range(6):
        z = np.random.default_rng(seed).normal(size=2000)
        found = tune_model(motion(1).to_model(1.0, 1.0), z)
        assert found.model.Q[0, 0] < 3 * found.process_error[0, 0] < 1e-3
        assert found.model.R[0, 0] == pytest.approx(1.0, abs=4 * found.noise_error[0, 0])
        if found.not_identifiable:
            said += 1
            assert found.not_identifiable[0].startswith("Q[0,0] cannot be distinguished from zero")
            larger = with_covariances(found.model, found.model.Q + found.process_error, found.model.R)
            assert found.log_likelihood - log_likelihood(larger, z) == pytest.approx(0.5, abs=0.05)
    assert said >= 2


@pytest.mark.parametrize("freedom", ["diagonal", "full"])
def test_where_there_is_no_maximum_no_errors_are_told(freedom: Freedom) -> None:
    """Readings that are all zero grow ever likelier as the noise shrinks."""
    found = tune_model(unknowing(PLANE), np.zeros((600, 2)), freedom, freedom)
    assert [sentence[:23] for sentence in found.not_identifiable] == ["No maximum was reached:"]
    assert np.isinf(np.diag(found.process_error)).all()
    assert np.isinf(np.diag(found.noise_error)).all()


def test_what_cannot_be_tuned_is_refused() -> None:
    with pytest.raises(ModelError, match="Nothing of Q and R is free"):
        tune_model(PLANE, RECORD, "fixed", "fixed")
    with pytest.raises(RecordingError, match="8 readings came; 6 unknowns of Q and R and 2 states need more than 8"):
        tune_model(PLANE, RECORD[:4], "full", "full")
    with pytest.raises(ModelError, match="this model needs"):
        tune_model(PLANE, RECORD[:, 0])


@pytest.mark.slow
def test_many_samples_of_three_channels_are_tuned_within_their_errors() -> None:
    z = simulate(CAR, 300_000, seed=10)
    found = tune_model(unknowing(CAR), z)
    assert np.abs(deviations(found, CAR)).max() < 4
