"""The filter and the smoother of several modes, in C, are the twins of `switching_reference`."""

from __future__ import annotations

import numpy as np
import pytest

from banks import bank_of, kernels, laid_out, record, tones
from becalm.core.arrays import Floats
from becalm.core.imm.modes import InteractingModels, Mode
from becalm.core.model.components import motion
from becalm.core.reference import imm as reference
from becalm.native.imm import ImmBuffers, ModeMatrices

TWIN = 1e-10
LONG = 1e-10
ROWS = 120
SIZES = [(1, 1), (1, 2), (1, 4), (2, 2), (2, 3), (2, 4), (3, 1), (3, 2)]
KINDS = ["even", "holes", "uneven", "repeats", "wild"]


def told(switching: InteractingModels, beliefs: list[reference.ModeStates]) -> dict[str, Floats]:
    """Return signal, sigma, probabilities and means as the kernels write them."""
    C = switching.component.signal_output[0]
    merged = [reference.collapse(own.mu, own.x, own.P) for own in beliefs]
    return {
        "signal": np.array([C @ x for x, _ in merged]),
        "sigma": np.array([np.sqrt(C @ P @ C) for _, P in merged]),
        "probability": np.array([own.mu for own in beliefs]).T,
        "mean": np.array([x for x, _ in merged]).T,
    }


def assert_twin(trace: ImmBuffers, expected: dict[str, Floats], within: float) -> None:
    for name, values in expected.items():
        got = getattr(trace, name)
        size = np.nanmax(np.abs(values), axis=-1, initial=0.0, keepdims=True)
        assert np.array_equal(np.isnan(got), np.isnan(values)), name
        worst = np.nanmax(np.abs(got - values) / size)
        assert worst < within, f"{name}: {worst:.2g}"


def check(switching: InteractingModels, kind: str, within: float = TWIN) -> None:
    z, elapsed = record(ROWS, kind)
    bank, steps = laid_out(switching, elapsed)
    forward, back, total = kernels(switching, z, elapsed)
    rows = reference.filter_readings(bank, switching.start, z, steps)
    expected = told(switching, [row.posterior for row in rows])
    expected["innovation"] = np.array([row.innovation for row in rows])
    expected["innovation_sigma"] = np.array([row.innovation_sigma for row in rows])
    assert_twin(forward, expected, within)
    wild = np.array([row.wild for row in rows])
    np.testing.assert_allclose(forward.wild, wild, rtol=0, atol=within)
    assert total == pytest.approx(sum(row.log_likelihood for row in rows), rel=within)
    smoothed = reference.smooth(bank, rows, np.append(steps, -1))
    assert_twin(back, told(switching, smoothed), within)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("order", "modes"), SIZES)
def test_the_kernels_are_the_reference(order: int, modes: int, kind: str) -> None:
    check(bank_of(order, modes), kind)


@pytest.mark.parametrize("rejects", [False, True])
@pytest.mark.parametrize(("order", "modes"), [(1, 2), (2, 3), (3, 2)])
def test_wild_readings_believed_and_rejected(order: int, modes: int, rejects: bool) -> None:
    check(bank_of(order, modes, share=0.05, rejects=rejects), "wild")


def test_a_jump_that_one_mode_could_never_explain_is_the_reference() -> None:
    switching = InteractingModels((Mode("calm", motion(1, 1e-6), 1.0, 3000.0), Mode("burst", motion(1, 1e3), 1.0, 2.7)))
    z = np.random.default_rng(2).normal(size=ROWS)
    z[60:] += 60.0
    bank, steps = laid_out(switching, np.ones(ROWS))
    _, back, _ = kernels(switching, z, np.ones(ROWS))
    long = ModeMatrices(*(np.asarray(array, np.longdouble) for array in bank))  # type: ignore[arg-type]
    rows = reference.filter_readings(long, switching.start.astype(np.longdouble), z.astype(np.longdouble), steps)
    assert_twin(back, told(switching, reference.smooth(long, rows, np.append(steps, -1))), LONG)
    assert np.abs(back.signal[:60]).max() < 2.0


@pytest.mark.parametrize("switching", [bank_of(4, 2), bank_of(5, 2), tones(2)], ids=["order 4", "order 5", "two tones"])
@pytest.mark.parametrize("kind", ["even", "holes", "uneven"])
def test_many_states_are_the_reference_in_long_double(switching: InteractingModels, kind: str) -> None:
    """A mode whose states sleep beside one that has many: there digits are lost first."""
    z, elapsed = record(ROWS, kind)
    bank, steps = laid_out(switching, elapsed)
    forward, back, _ = kernels(switching, z, elapsed)
    long = ModeMatrices(*(np.asarray(array, np.longdouble) for array in bank))  # type: ignore[arg-type]
    rows = reference.filter_readings(long, switching.start.astype(np.longdouble), z.astype(np.longdouble), steps)
    assert rows[-1].posterior.P.dtype == np.longdouble
    assert_twin(forward, told(switching, [row.posterior for row in rows]), LONG)
    assert_twin(back, told(switching, reference.smooth(long, rows, np.append(steps, -1))), LONG)
