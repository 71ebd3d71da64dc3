"""A channel with a fixed lag: in stretches it is the whole one to the bit, and the record cut after the lag."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Floats
from becalm.core.filter.filtering import run_filter
from becalm.core.filter.fixed_lag_flow import FixedLagFlow
from becalm.core.filter.smoothing import run_smoother
from becalm.core.fixed_lag import fixed_lag_smoother
from becalm.core.model.components import motion, oscillator
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.core.online import Online

ROWS = 600
KINDS = ["even", "holes", "gaps", "stamps", "late"]
PART = motion(2, 1e-3)


def record(kind: str) -> tuple[Floats, Floats]:
    """Readings and the steps before them: a walk in noise, with what `kind` says."""
    rng = np.random.default_rng(5)
    z, elapsed = 100 + np.cumsum(0.1 * rng.normal(size=ROWS)) + rng.normal(size=ROWS), np.ones(ROWS)
    if kind == "holes":
        z[rng.random(ROWS) < 0.02], z[300:340] = np.nan, np.inf
    elif kind == "gaps":
        elapsed[[70, 128, 300]] = 3.0, 40.0, 7.0
    elif kind == "stamps":
        elapsed[1:] = rng.exponential(size=ROWS - 1)
    elif kind == "late":
        z[:250] = np.nan
    return z, elapsed


def flow(lag: int, readings: tuple[Floats, Floats], at: list[int]) -> tuple[Floats, Floats, FixedLagFlow, Floats]:
    shown: list[Floats] = []
    made = FixedLagFlow(PART, 1.0, lag=lag, judge=lambda nu, sigma: shown.append(nu / sigma))
    z, elapsed = readings
    told = []
    for start, stop in zip([0, *at], [*at, len(z)], strict=True):
        told += made.push(z[start:stop], elapsed[start:stop])
    told += made.finish()
    signal, sigma = (np.concatenate([part[field] for part in told]) for field in (0, 1))
    return signal, sigma, made, np.concatenate(shown)


@pytest.mark.parametrize("lag", [1, 9])
@pytest.mark.parametrize("kind", KINDS)
def test_a_row_is_that_of_the_record_cut_after_the_lag(kind: str, lag: int) -> None:
    z, elapsed = record(kind)
    signal, sigma, made, shown = flow(lag, (z, elapsed), [])
    model = PART.to_model(1.0, 1.0)
    for k in range(0, ROWS, 7):
        until = k + lag + 1
        line = elapsed_timeline(PART, 1.0, elapsed[:until])
        cut = run_smoother(model, line, z[:until, np.newaxis])
        assert signal[k] == pytest.approx(cut.signal[k, 0], rel=1e-10, nan_ok=True)
        assert sigma[k] == pytest.approx(cut.sigma[k, 0], rel=1e-10)
    whole = run_filter(model, elapsed_timeline(PART, 1.0, elapsed), z[:, np.newaxis]).estimate
    assert made.log_likelihood == pytest.approx(whole.log_likelihood, rel=1e-10)
    expected = whole.innovations[:, 0] / whole.innovation_sigma[:, 0]
    np.testing.assert_allclose(shown, expected, rtol=1e-8, atol=1e-10)


@given(kind=st.sampled_from(KINDS), lag=st.sampled_from([1, 9, 50]), at=st.lists(st.integers(0, ROWS), max_size=6))
@settings(max_examples=40)
def test_stretches_are_the_whole_to_the_bit(kind: str, lag: int, at: list[int]) -> None:
    whole, parts = flow(lag, record(kind), []), flow(lag, record(kind), sorted(at))
    for one, other in zip(whole[:2], parts[:2], strict=True):
        assert one.shape == (ROWS,)
        assert np.array_equal(one, other, equal_nan=True)
    assert whole[2].settled_row == parts[2].settled_row


def test_a_file_is_the_stream() -> None:
    z, elapsed = record("holes")
    signal, sigma, *_ = flow(9, (z, elapsed), [])
    online = Online(PART.to_model(1.0, 1.0), 9)
    told, spread = online.run(z)
    last = online.finish()
    np.testing.assert_allclose(np.append(told[9:, 0], last[0][:, 0]), signal, rtol=1e-12)
    np.testing.assert_allclose(np.append(spread[9:, 0], last[1][:, 0]), sigma, rtol=1e-12)


def test_parts_add_up_and_a_disturbance_is_no_signal() -> None:
    z, elapsed = record("holes")
    hum = oscillator(0.2, 0.01, 0.01).as_disturbance()
    made = FixedLagFlow(PART + hum, 1.0, lag=20, split=True)
    told = [*made.push(z, elapsed), *made.finish()]
    signal, parts = np.concatenate([part.signal for part in told]), np.hstack([part.parts for part in told])
    np.testing.assert_allclose(parts[0], signal, rtol=1e-12)
    read, _ = fixed_lag_smoother((PART + hum).to_model(1.0, 1.0), z, 20)
    np.testing.assert_allclose(parts.sum(axis=0), read[:, 0], rtol=1e-9)
    assert np.abs(parts[1]).max() > 0.1
