"""Gates: spikes are left out, steps are followed, nothing is locked out, and cuts change no bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm, poisson

from becalm.core.arrays import Codes, Floats
from becalm.core.filter.gate import LEAST_THRESHOLD, Gate, threshold_for
from becalm.core.model.components import Component, motion, oscillator
from becalm.core.reading_verdicts import Verdict
from becalm.core.rows import EstimatedRows
from becalm.errors import ModelError
from flows import flow_of

ROWS = 4096
GATE = Gate(5.0)
SMOOTHED = {1: 1e-12, 2: 1e-12, 4: 1e-8}  # of sigma: of order 4 cuts change 3e-9 at the start without a gate as well
STEEP = 30.0  # a reading
STRANGE = [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e99, -1e99, 1e30, 1e18, 1e12, 1e6, -8.0]


def component_of(order: int, cutoff: float = 0.01) -> Component:
    """Return a motion whose steady filter has a cut-off, in cycles a step, beside noise of variance one."""
    return motion(order, (2 * np.pi * cutoff) ** (2 * order))


def even(rows: int) -> Floats:
    elapsed = np.ones(rows)
    elapsed[0] = 0.0
    return elapsed


def told_of(  # noqa: PLR0913  (each by its name)
    component: Component,
    z: Floats,
    *,
    causal: bool,
    gate: Gate | None = GATE,
    cuts: tuple[int, ...] = (),
    elapsed: Floats | None = None,
) -> EstimatedRows:
    flow = flow_of(component, 1.0, causal=causal, gate=gate)
    steps = even(len(z)) if elapsed is None else elapsed
    told: list[EstimatedRows] = []
    for start, stop in zip([0, *cuts], [*cuts, len(z)], strict=True):
        told += flow.push(z[start:stop], steps[start:stop])
    told += flow.finish()
    assert sum(len(part.signal) for part in told) == len(z)
    return EstimatedRows.joined(told)


def noise(seed: int, rows: int = ROWS) -> Floats:
    return np.random.default_rng(seed).normal(size=rows)


def spikes(seed: int, share: float, size: float, rows: int = ROWS) -> Floats:
    rng = np.random.default_rng(seed + 1000)
    return np.where(rng.random(rows) < share, size * rng.choice([-1.0, 1.0], rows), 0.0)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("share", "verdict"), [(0.9999, Verdict.USED), (1.0001, Verdict.SPIKE)])
def test_the_threshold_is_that_of_the_innovation_once_the_gain_has_settled(
    sign: float, share: float, verdict: Verdict
) -> None:
    """A random walk predicts its last estimate, with the variance of the closed form."""
    q, row = 0.01, ROWS - 1
    S = 1 + (q + np.sqrt(q * q + 4 * q)) / 2
    z = noise(3)
    z[row] = told_of(motion(1, q), z, causal=True).signal[row - 1] + sign * share * 5.0 * np.sqrt(S)
    assert told_of(motion(1, q), z, causal=True).verdicts[row] == verdict


@pytest.mark.parametrize("rate_hz", [500.0, 10_000.0, 1e6])
def test_the_threshold_has_the_false_alarms_asked(rate_hz: float) -> None:
    z = threshold_for(1.0, rate_hz)
    assert 2 * norm.sf(z) * rate_hz * 3600 == pytest.approx(1.0, rel=1e-9)


def test_the_threshold_is_never_so_narrow_that_it_costs_good_readings() -> None:
    assert threshold_for(1.0, 1 / 60) == LEAST_THRESHOLD
    assert threshold_for(1e9, 1.0) == LEAST_THRESHOLD


@pytest.mark.parametrize("rates", [(0.0, 1.0), (1.0, 0.0), (np.nan, 1.0), (1.0, np.inf)])
def test_what_is_no_rate_is_refused(rates: tuple[float, float]) -> None:
    with pytest.raises(ModelError, match="is not a rate"):
        threshold_for(*rates)


@pytest.mark.parametrize("gate", [(0.0, 5, 50), (np.nan, 5, 50), (5.0, 1, 50), (5.0, 6, 5)])
def test_what_is_no_gate_is_refused(gate: tuple[float, int, int]) -> None:
    with pytest.raises(ModelError, match=r"came|not a threshold"):
        Gate(*gate)


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_where_nothing_is_rejected_the_bits_are_those_without_a_gate(order: int, causal: bool) -> None:
    part, z = component_of(order), noise(order)
    free, gated = (told_of(part, z, causal=causal, gate=gate) for gate in (None, Gate(6.0)))
    assert np.array_equal(free.signal, gated.signal)
    assert np.array_equal(free.sigma, gated.sigma)
    assert not gated.verdicts.any()


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_spikes_are_as_if_they_had_not_come(order: int, causal: bool) -> None:
    part, z, bad = component_of(order), noise(order), spikes(order, 0.02, 15.0)
    bad[:50] = 0.0
    told = told_of(part, z + bad, causal=causal)
    assert np.array_equal(told.verdicts == Verdict.SPIKE, bad != 0)
    missing = told_of(part, np.where(bad != 0, np.nan, z), causal=causal, gate=None)
    assert np.array_equal(told.signal, missing.signal)
    assert np.array_equal(told.sigma, missing.sigma)


@pytest.mark.parametrize("kind", ["spikes", "steps", "both", "holes", "stamps", "start"])
@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("order", [1, 2, 4])
def test_cuts_at_blocks_change_nothing(order: int, causal: bool, kind: str) -> None:
    z, elapsed = noise(order), even(ROWS)
    if kind in ("spikes", "both"):
        z += spikes(order, 0.02, 12.0)
    if kind in ("steps", "both", "holes"):
        z[1022:] += 60.0  # decided across a cut
        z[2048:] -= 90.0
        z[ROWS - 3 :] += 70.0  # never decided
    if kind == "holes":
        z[1024:1030], z[2050:2300] = np.nan, np.inf
    if kind == "stamps":
        elapsed[1:] = np.random.default_rng(3).exponential(size=ROWS - 1)
        z[1023:] += 200.0
    if kind == "start":
        z[0], z[1], z[:1] = 30.0, -20.0, 40.0
    part = component_of(order)
    whole = told_of(part, z, causal=causal, elapsed=elapsed)
    for cuts in ((1024, 2048, 3072), tuple(range(256, ROWS, 256))):
        cut = told_of(part, z, causal=causal, cuts=cuts, elapsed=elapsed)
        assert np.array_equal(whole.verdicts, cut.verdicts)
        if causal:
            assert np.array_equal(whole.signal, cut.signal, equal_nan=True)
            assert np.array_equal(whole.sigma, cut.sigma, equal_nan=True)
        else:
            assert (np.abs(whole.signal - cut.signal) / whole.sigma).max() < 1e-10
            np.testing.assert_allclose(cut.sigma, whole.sigma, rtol=SMOOTHED[order])
    assert (whole.verdicts >= Verdict.SPIKE).any()


@pytest.mark.parametrize("size", [50.0, -50.0, 1e6])
@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_a_step_is_followed_within_the_readings_that_agree(order: int, size: float) -> None:
    z = noise(order) + np.where(np.arange(ROWS) >= 2000, size, 0.0)
    told = told_of(component_of(order), z, causal=True)
    assert np.flatnonzero(told.verdicts == Verdict.STEP).tolist() == [2000 + GATE.agree - 1]
    followed = 2000 + GATE.agree - 1
    assert np.abs(told.signal[followed:2100] - size).max() < 5.0
    assert np.abs(told.signal[:followed]).max() < 5.0


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_smoother_steps_where_the_signal_did(order: int) -> None:
    truth = np.where(np.arange(ROWS) >= 2000, 50.0, 0.0)
    told = told_of(component_of(order), noise(order) + truth, causal=False)
    assert np.flatnonzero(told.verdicts == Verdict.STEP).tolist() == [2000]
    assert not (told.verdicts == Verdict.SPIKE).any()
    assert np.abs(told.signal - truth).max() < 5.0


def longest_rejected(verdicts: Codes) -> int:
    bounds = np.flatnonzero(np.concatenate([[True], verdicts != Verdict.SPIKE, [True]]))
    return int(np.diff(bounds).max()) - 1


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_nothing_is_locked_out(order: int, causal: bool) -> None:
    """Ramps that begin at once, stairs up and down, a long burst of anything: the end is always found again."""
    rng, k = np.random.default_rng(order), np.arange(ROWS)
    records = {
        "ramp": np.maximum(k - 1000, 0) * 0.5,
        "steep ramp": np.maximum(k - 1000, 0) * STEEP,
        "stairs": 80.0 * ((k // 300) % 3),
        "burst": np.where((k > 1000) & (k < 1400), rng.uniform(-300, 300, ROWS), 0.0),
        "square": 40.0 * ((k // 8) % 2),
    }
    for name, truth in records.items():
        told = told_of(component_of(order, 0.02), noise(order) + truth, causal=causal)
        assert longest_rejected(told.verdicts) <= GATE.at_most, name
        if name != "square":
            lost = STEEP * GATE.at_most if name == "steep ramp" and order == 1 else 20.0  # no two readings agree
            assert np.abs(told.signal - truth)[-200:].mean() < lost, name


@pytest.mark.parametrize("seed", range(5))
def test_bursts_of_random_spikes_are_no_step(seed: int) -> None:
    bad = spikes(seed, 0.03, 1.0) * np.random.default_rng(seed).uniform(15, 500, ROWS)
    burst = slice(2000, 2012)
    bad[burst] = np.random.default_rng(seed).permutation(np.linspace(100, 1200, 12)) * np.resize([1, -1], 12)
    bad[:20] = 0.0
    told = told_of(component_of(2), noise(seed) + bad, causal=True, gate=Gate(5.0, agree=5, at_most=50))
    assert not (told.verdicts == Verdict.STEP).any()
    assert np.array_equal(told.verdicts == Verdict.SPIKE, bad != 0)


def shock(width: int, size: float) -> Floats:
    """Return a half-sine shock and the ringing after it."""
    k = np.arange(ROWS) - 2000.0
    pulse = np.where((k > 0) & (k < width), size * np.sin(np.pi * k / width), 0.0)
    ringing = 0.3 * size * np.exp(-np.maximum(k, 0) / (2 * width)) * np.sin(6 * np.pi * k / width)
    return pulse + np.where(k > 0, ringing, 0.0)


@pytest.mark.parametrize("size", [50.0, 400.0, 1000.0])
@pytest.mark.parametrize("width", [10, 55, 220])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_shock_is_followed_though_the_gate_knew_only_rest(order: int, width: int, size: float) -> None:
    """A causal filter leaves out the first readings, fewer than `at_most`, and few later; a smoother, next to none."""
    truth = shock(width, size)
    causal, smoothed = (told_of(component_of(order), noise(7) + truth, causal=causal) for causal in (True, False))
    moving = np.abs(truth) > 20.0
    left_out = [np.count_nonzero((told.verdicts == Verdict.SPIKE)[moving]) for told in (causal, smoothed)]
    assert longest_rejected(causal.verdicts) < GATE.at_most
    assert left_out[0] <= max(GATE.at_most - 1, 0.12 * np.count_nonzero(moving))
    assert left_out[1] <= 0.04 * np.count_nonzero(moving)
    assert np.sqrt(np.mean((smoothed.signal - truth)[moving] ** 2)) < 10.0 + 0.02 * size


@pytest.mark.parametrize("causal", [True, False])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_spike_in_the_first_readings_is_overcome(order: int, causal: bool) -> None:
    for row in range(order + 1):
        z = noise(row)
        z[row] += 30.0
        assert np.abs(told_of(component_of(order), z, causal=causal).signal[100:]).max() < 2.0


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("later", [6, 9, 14])
def test_a_spike_beside_a_step_is_a_spike(order: int, later: int) -> None:
    """It is far beyond the step: motion that goes on grows from reading to reading."""
    z = noise(3)
    z[2000:] += 30.0
    z[2000 + 4 + later] += 5000.0
    told = told_of(component_of(order), z, causal=True)
    assert told.verdicts[2000 + 4 + later] == Verdict.SPIKE
    assert np.abs(told.signal[2100:] - 30.0).max() < 5.0


@pytest.mark.parametrize("causal", [True, False])
def test_a_step_leaves_a_tone_alone(causal: bool) -> None:
    k = np.arange(ROWS)
    tone, truth = 3 * np.sin(0.4 * k), np.where(k >= 2000, 60.0, 0.0)
    part = component_of(1, 0.002) + oscillator(0.4 / (2 * np.pi), 0.0, 1e-6)
    told = told_of(part, noise(3) + tone + truth, causal=causal)
    assert np.count_nonzero(told.verdicts == Verdict.STEP) == 1
    assert np.abs(told.signal - tone - truth)[2030:].max() < 2.5


strange = st.lists(st.tuples(st.integers(0, 700), st.sampled_from(STRANGE)), max_size=60)


@settings(max_examples=60)
@given(strange, st.sampled_from([1, 2, 3]), st.booleans(), st.booleans())
def test_whatever_comes_the_state_stays_finite(
    faults: list[tuple[int, float]], order: int, causal: bool, at_once: bool
) -> None:
    """From the first row on, which nothing before it tells to be absurd, once as many readings came as tell a state."""
    z = noise(order, 1024)
    for place, (row, value) in enumerate(faults):
        z[300 + place if at_once else row] = value
    told = told_of(component_of(order, 0.05), z, causal=causal, cuts=(256, 512))
    first = int(np.flatnonzero(np.isfinite(told.signal))[order - 1])
    assert np.isfinite(told.signal[first:]).all()
    assert np.isfinite(told.sigma[first:]).all()
    assert np.abs(told.signal[-1]) < 20.0


@pytest.mark.parametrize("value", [1e3, 1e6, -1e9, 1e13])
@pytest.mark.parametrize("row", [0, 1, 2, 3, 7])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_start_from_wild_readings_is_overcome(order: int, row: int, value: float) -> None:
    """Where the first states are so far off that a covariance that covers them has no digit left for the readings."""
    for other in (None, 0, 2, 5):
        z = noise(order, 1024)
        z[row] = value
        if other is not None:
            z[other] = -value / 3
        told = told_of(component_of(order, 0.05), z, causal=True, cuts=(256, 512))
        assert np.abs(told.signal[400:]).max() < 20.0


@pytest.mark.parametrize("value", [1e6, 1e12])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_stretch_of_wild_readings_is_overcome(order: int, value: float) -> None:
    """Though each of them may ask for a jump of its own."""
    for start in (0, 300):
        z = noise(order, 1024)
        z[start : start + 300] = value * np.random.default_rng(order).choice([-1.0, 1.0], 300)
        told = told_of(component_of(order, 0.05), z, causal=True, cuts=(256, 512))
        assert np.abs(told.signal[start + 500 :]).max() < 20.0


def count_false_alarms(rate_hz: float, rows: int, block: int = 1 << 20) -> int:
    flow = flow_of(component_of(1), 1.0, causal=True, gate=Gate(threshold_for(1.0, rate_hz)))
    rng, count, level = np.random.default_rng(int(rate_hz)), 0, 0.0
    for _ in range(rows // block):
        walk = level + np.cumsum(2 * np.pi * 0.01 * rng.normal(size=block))
        level = float(walk[-1])
        told = flow.push(walk + rng.normal(size=block), np.ones(block))
        count += sum(int(np.count_nonzero(part.verdicts)) for part in told)
    return count


@pytest.mark.slow
@pytest.mark.parametrize(("rate_hz", "rows"), [(500.0, 48 << 20), (10_000.0, 96 << 20)])
def test_false_alarms_are_one_an_hour(rate_hz: float, rows: int) -> None:
    """Of 28 alarms expected, and of 2.8."""
    expected = rows / rate_hz / 3600
    low, high = poisson.interval(0.99, expected)
    assert low <= count_false_alarms(rate_hz, rows) <= high
