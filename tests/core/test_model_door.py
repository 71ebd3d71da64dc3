"""The one door: what does not fit is refused by name; what fits is copied, frozen and left alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from becalm.core.filter.batch import filter_batch
from becalm.core.filter.filtering import kalman_filter
from becalm.core.filter.smoothing import kalman_smoother
from becalm.core.model.components import level
from becalm.core.model.model import Model
from becalm.core.model.prior import refuse_singular
from becalm.core.model.step_matrices import model_system
from becalm.core.online import Online
from becalm.core.recording import Recording
from becalm.errors import BecalmError, ModelError, TimeError

ONE = Model(F=1.0, H=1.0, Q=1.0, R=1.0, x0=[0.0], P0=[[1.0]])
GOOD: dict[str, Any] = {
    "F": [[1.0, 0.1], [0.0, 1.0]],
    "H": [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]],
    "Q": [[0.2]],
    "R": [[1.0, 0.2, 0.0], [0.2, 2.0, 0.0], [0.0, 0.0, 0.5]],
    "G": [[0.005], [0.1]],
    "x0": [1.0, 2.0],
    "P0": [[4.0, 1.0], [1.0, 3.0]],
}
WRONG_SHAPES: dict[str, list[Any]] = {
    "F": [[1.0, 2.0], np.ones((2, 3)), np.ones((2, 2, 2)), [[]], np.empty((0, 0))],
    "H": [[1.0, 0.0], np.ones((3, 3)), 1.0, np.ones((1, 2, 1)), np.empty((0, 2))],
    "Q": [np.eye(2), [1.0], np.ones((1, 2)), np.ones((1, 1, 1))],
    "R": [1.0, np.eye(2), np.ones((3, 1)), [1.0, 2.0, 3.0]],
    "G": [np.eye(3), [0.1, 0.2], 1.0, np.empty((2, 0))],
    "x0": [1.0, [1.0], [1.0, 2.0, 3.0], [[1.0], [2.0]], [[1.0, 2.0]]],
    "P0": [np.eye(3), [1.0, 2.0], 4.0, np.ones((2, 1))],
}
NOT_NUMBERS: list[Any] = ["steep", [["a"]], [[1.0], [1.0, 2.0]], {"a": 1}, [[1 + 2j]], object()]


def with_entry(name: str, value: float) -> Any:
    changed = np.array(GOOD[name], dtype=float)
    changed.flat[-1] = value
    return changed


def refusal(**changes: Any) -> str:
    with pytest.raises(ModelError) as caught:
        Model(**(GOOD | changes))
    assert isinstance(caught.value, BecalmError)
    assert isinstance(caught.value, ValueError)
    return str(caught.value)


@pytest.mark.parametrize(("name", "value"), [(name, value) for name in WRONG_SHAPES for value in WRONG_SHAPES[name]])
def test_a_wrong_shape_is_refused_by_name(name: str, value: Any) -> None:
    shape = np.shape(value) if np.ndim(value) or name == "x0" else (1, 1)  # a number is a matrix of one
    assert refusal(**{name: value}).startswith(f"{name} has shape {shape}")


@pytest.mark.parametrize("name", GOOD)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_number_that_is_not_finite_is_refused_by_name(name: str, value: float) -> None:
    assert refusal(**{name: with_entry(name, value)}).startswith(f"{name} holds a number that is not finite")


@pytest.mark.parametrize("name", GOOD)
@pytest.mark.parametrize("value", NOT_NUMBERS, ids=lambda value: type(value).__name__)
def test_what_is_not_numbers_is_refused_by_name(name: str, value: Any) -> None:
    assert refusal(**{name: value}).startswith(f"{name} ")


@pytest.mark.parametrize("name", ["F", "H", "Q", "R"])
def test_what_is_needed_cannot_be_none(name: str) -> None:
    assert refusal(**{name: None}).startswith(f"{name} ")


@pytest.mark.parametrize("name", ["R", "P0"])
def test_an_asymmetric_covariance_is_refused_by_name(name: str) -> None:
    changed = np.array(GOOD[name], dtype=float)
    changed[0, 1] += 1e-3
    assert refusal(**{name: changed}).startswith(f"{name} is not symmetric")


@pytest.mark.parametrize(
    ("name", "value"),
    [("Q", [[-0.1]]), ("R", np.diag([1.0, -1e-6, 1.0])), ("P0", [[1.0, 2.0], [2.0, 1.0]]), ("P0", -np.eye(2))],
)
def test_an_indefinite_covariance_is_refused_by_name(name: str, value: Any) -> None:
    assert refusal(**{name: value}).startswith(f"{name} is not a covariance: its smallest eigenvalue is -")


@pytest.mark.parametrize("name", ["x0", "P0"])
def test_one_of_x0_and_p0_alone_is_refused(name: str) -> None:
    assert refusal(**{name: None}).startswith("x0 and P0 belong together")


def test_rounding_does_not_make_a_covariance_indefinite_or_asymmetric() -> None:
    edge = np.array([0.3, 0.7, 1.1])
    singular = np.outer(edge, edge)
    singular[0, 1] *= 1 + 1e-15
    model = Model(**(GOOD | {"R": singular}))
    assert np.array_equal(model.R, model.R.T)


def test_semidefinite_and_zero_covariances_are_welcome() -> None:
    model = Model(**(GOOD | {"Q": [[0.0]], "R": np.zeros((3, 3)), "P0": np.ones((2, 2))}))
    assert not model.process_covariance.any()


@pytest.mark.parametrize("wrap", [np.array, np.ndarray.tolist, np.asfortranarray], ids=["arrays", "lists", "fortran"])
def test_the_callers_matrices_are_copied_and_untouched(wrap: Any) -> None:
    given = {name: wrap(np.array(value)) for name, value in GOOD.items()}
    before = {name: np.array(value) for name, value in given.items()}
    model = Model(**given)
    kalman_filter(model, np.ones((10, 3)))
    for name, value in given.items():
        own = getattr(model, name)
        assert np.array_equal(value, before[name])
        assert np.array_equal(own, before[name])
        assert not own.flags.writeable
        assert own.flags.c_contiguous  # as C reads it
        assert not np.shares_memory(own, np.asarray(value))
        if isinstance(value, np.ndarray):
            assert value.flags.writeable
            value[...] = 77.0
            assert np.array_equal(own, before[name])


def test_scalars_stand_for_matrices_of_one() -> None:
    model = Model(F=1, H=1, Q=2, R=3)
    assert (model.states, model.channels) == (1, 1)
    assert np.array_equal(kalman_filter(model, [1, 2, 3]).signal.shape, (3, 1))


def test_integers_are_numbers() -> None:
    small = np.eye(2, dtype=np.int8)
    whole = Model(F=[[1, 1], [0, 1]], H=[[1, 0]], Q=small, R=[[2]], x0=[0, 0], P0=small)
    real = Model(F=[[1.0, 1.0], [0.0, 1.0]], H=[[1.0, 0.0]], Q=np.eye(2), R=[[2.0]], x0=[0.0, 0.0], P0=np.eye(2))
    z = np.arange(20)
    assert np.array_equal(kalman_filter(whole, z).signal, kalman_filter(real, z.astype(float)).signal)
    assert np.array_equal(kalman_filter(whole, z.astype(np.uint8)).signal, kalman_filter(real, list(z)).signal)


READINGS = np.random.default_rng(0).normal(size=(60, 3))


def read_only() -> Any:
    z = READINGS.copy()
    z.flags.writeable = False
    return z


LAYOUTS = {
    "lists": READINGS.tolist(),
    "read-only": read_only(),
    "every other row": np.repeat(READINGS, 2, axis=0)[::2],
    "backwards": READINGS[::-1].copy()[::-1],
    "fortran": np.asfortranarray(READINGS),
    "big-endian": READINGS.astype(">f8"),
    "a slice of more channels": np.hstack([READINGS, READINGS])[:, :3],
}


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("run", [kalman_filter, kalman_smoother])
@pytest.mark.parametrize("flat", [True, False])
def test_readings_of_any_layout_give_the_same_and_stay(name: str, run: Any, flat: bool) -> None:
    model = Model(**(GOOD | {"x0": None, "P0": None})) if flat else Model(**GOOD)
    z = LAYOUTS[name]
    before = np.array(z)
    expected, got = run(model, READINGS), run(model, z)
    assert np.array_equal(got.signal, expected.signal, equal_nan=True)
    assert np.array_equal(got.sigma, expected.sigma)
    assert np.array_equal(np.array(z), before)


def test_a_reading_that_is_infinite_is_not_there() -> None:
    model, z = Model(**GOOD), READINGS.copy()
    z[4, 1], z[9], z[20, 2] = np.inf, -np.inf, np.nan
    holed = np.where(np.isfinite(z), z, np.nan)
    for run in (kalman_filter, kalman_smoother):
        assert np.array_equal(run(model, z).signal, run(model, holed).signal)
    assert np.isinf(z[4, 1])


@pytest.mark.parametrize(
    ("z", "says"),
    [
        (np.zeros(5), r"z has shape \(5,\); this model needs \(N, 3\)"),
        (np.zeros((5, 2)), r"z has shape \(5, 2\); this model needs \(N, 3\)"),
        (np.zeros((2, 5, 3)), r"z has shape \(2, 5, 3\)"),
        (3.0, r"z has shape \(\)"),
        ("words", "z is not an array of numbers"),
        ([[1, 2, 3], [1, 2]], "z is not an array of numbers"),
    ],
)
def test_readings_that_do_not_fit_are_refused_by_name(z: Any, says: str) -> None:
    for run in (kalman_filter, kalman_smoother):
        with pytest.raises(ModelError, match=f"^{says}"):
            run(Model(**GOOD), z)


def test_one_channel_may_come_as_a_row_of_numbers() -> None:
    model = Model(F=[[1]], H=[[1]], Q=[[1]], R=[[1]])
    assert np.array_equal(kalman_filter(model, READINGS[:, 0]).signal, kalman_filter(model, READINGS[:, :1]).signal)
    with pytest.raises(ModelError, match=r"this model needs \(N,\) or \(N, 1\)"):
        kalman_filter(model, READINGS)


@pytest.mark.parametrize(("name", "value"), [("R", np.zeros((3, 3))), ("F", [[1.0, 1.0], [1.0, 1.0]])])
def test_a_flat_start_needs_an_inverse(name: str, value: Any) -> None:
    model = Model(**(GOOD | {"x0": None, "P0": None, name: value}))
    for run in (kalman_filter, kalman_smoother):
        with pytest.raises(ModelError, match=f"^{name} has no inverse.*Give x0 and P0"):
            run(model, READINGS)


@pytest.mark.parametrize("unit", [1e-150, 1e-9, 1e9, 1e150])
def test_a_flat_start_does_not_depend_on_the_unit_of_a_channel(unit: float) -> None:
    """A channel of tiny or huge numbers is none without noise; two that are the same are."""
    plain = Model(F=np.eye(2), H=np.eye(2), Q=np.eye(2), R=[[1.0, 0.5], [0.5, 1.0]])
    scaled = Model(F=np.eye(2), H=np.diag([1.0, unit]), Q=np.eye(2), R=[[1.0, 0.5 * unit], [0.5 * unit, unit**2]])
    refuse_singular(model_system(plain))
    refuse_singular(model_system(scaled))
    alike = Model(F=np.eye(2), H=np.eye(2), Q=np.eye(2), R=[[1.0, unit], [unit, unit**2]])
    with pytest.raises(ModelError, match=r"^R has no inverse"):
        refuse_singular(model_system(alike))


@pytest.mark.parametrize(
    ("F", "H", "expected"),
    [
        ([[1, 1], [0, 1]], [[1, 0]], (True, True)),
        ([[1, 1], [0, 1]], [[0, 1]], (False, True)),
        ([[1, 1e-4], [0, 1]], [[1, 0]], (True, True)),
        (np.eye(2), [[1, 1]], (False, False)),
        (np.eye(2), np.zeros((1, 2)), (False, False)),
        (np.diag([0.5, 0.9]), [[1, 1]], (True, True)),
    ],
)
def test_observable_states(F: Any, H: Any, expected: tuple[bool, ...]) -> None:
    assert Model(F=F, H=H, Q=np.eye(2), R=[[1]]).observable_states == expected


def test_a_model_says_its_size() -> None:
    assert repr(Model(**GOOD)) == "Model(2 states, 3 channels)"


def test_what_a_mask_hides_is_missing() -> None:
    hidden = np.ma.masked_array([0.0, 1e6, 0.0], mask=[False, True, False])
    seen, model = np.array([0.0, np.nan, 0.0]), Model(F=1.0, H=1.0, Q=1.0, R=1.0, x0=[0.0], P0=[[1.0]])
    np.testing.assert_array_equal(Recording(hidden, rate_hz=1.0).samples[:, 0], seen)
    np.testing.assert_array_equal(Recording([hidden, seen], rate_hz=1.0).samples, [seen, seen])
    np.testing.assert_array_equal(kalman_filter(model, hidden).sigma, kalman_filter(model, seen).sigma)
    assert Online(model).step(np.ma.masked)[1] == Online(model).step(np.nan)[1]
    with pytest.raises(TimeError, match="row 2 is missing"):
        Recording([1.0, 2.0, 3.0], times_s=np.ma.masked_array([0.0, 1.0, 2.0], mask=[False, True, False]))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: Online(None), "A Model is needed; NoneType came"),  # type: ignore[arg-type]
        (lambda: Online(level()), "A Model is needed; Component came"),  # type: ignore[arg-type]
        (lambda: Online(ONE, gate=3.0), "A Gate is needed; float came"),  # type: ignore[arg-type]
        (lambda: Online(ONE).step([[1.0], [2.0, 3.0]]), "not an array of numbers"),
        (lambda: filter_batch(None, [[[1.0]]]), "A Model is needed; NoneType came"),  # type: ignore[arg-type]
        (lambda: Model(F=10**400, H=1, Q=1, R=1), "F is not an array of real numbers"),
        (lambda: Recording([10**400, 1.0], rate_hz=1.0), "not an array of numbers"),
    ],
)
def test_a_mistake_is_a_sentence(call: Callable[[], object], says: str) -> None:
    with pytest.raises(BecalmError, match=says):
        call()
