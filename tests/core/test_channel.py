"""The filter in C: against the recursion in a hundred digits, and cut anywhere."""

from __future__ import annotations

from collections.abc import Iterator
from decimal import localcontext
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.core.arrays import Codes, Floats
from becalm.core.filter.channel import Channel, ChannelRecord, Estimates
from becalm.core.filter.channel_settings import ChannelSettings
from becalm.core.filter.gate import Gate
from becalm.core.filter.smoothed_flow import SmoothedFlow
from becalm.core.filter.smoothing import run_smoother
from becalm.core.health.faults import FaultCount
from becalm.core.health.limits import Limits
from becalm.core.health.monitor import Alarms
from becalm.core.health.outlier_rule import find_outlier_rule
from becalm.core.model.components import Component, bias, motion, oscillator, returning_motion
from becalm.core.model.step_matrices import elapsed_timeline
from becalm.core.reading_verdicts import LOST, Verdict
from becalm.core.rows import EstimatedRows
from becalm.errors import ModelError
from becalm.native import STATE
from becalm.native.library import COEFFICIENTS, MOST_STATES, SETTINGS
from bits import assert_same_bits
from hundred_digits import exact, exact_smoothed

ALARMS = Alarms(drift_threshold=10.0)
COMPONENTS = {
    **{f"order {order}": motion(order, 0.1 ** (2 * order)) for order in range(1, 6)},
    **{f"damped {order}": returning_motion(order, 0.1 ** (2 * order), 0.02) for order in range(1, 4)},
    "tone": motion(2, 1e-4) + oscillator(0.11, 0.01, 1e-3),
    "disturbed": motion(1, 0.01) + oscillator(0.17, 0.0, 1e-4).as_disturbance(),
}
KINDS = pytest.mark.parametrize("kind", COMPONENTS)
R, TWIN, OPENING, SMOOTHER = 0.7, 1e-11, 1e-8, 1e-9


def settings_of(component: Component, **more: Any) -> ChannelSettings:
    return ChannelSettings(component, R, 0.01, **({"limits": Limits(), "alarms": ALARMS} | more))


def channel(component: Component, **more: Any) -> Channel:
    return Channel(settings_of(component, **more))


def run(one: Channel, z: Floats, elapsed: Floats) -> tuple[Floats, Floats, Codes]:
    return one.process(z, elapsed)[:3]


def smoothed(component: Component, z: Floats, elapsed: Floats) -> tuple[Floats, Floats]:
    flow = SmoothedFlow(component, R)
    told = EstimatedRows.joined([*flow.push(z, elapsed), *flow.finish()])
    return told.signal, told.sigma


def stacked(estimates: Estimates) -> Floats:
    """Return all that is estimated, as rows (5, N)."""
    return np.stack([part.astype(np.float64) for part in estimates[:5]])


def rough(rows: int, seed: int = 0) -> Floats:
    """Return a walk with noise, and readings that are missing one by one and 30 in a row."""
    rng = np.random.default_rng(seed)
    z = 0.1 * np.cumsum(rng.normal(size=rows)) + rng.normal(size=rows)
    z[rng.random(rows) < 0.03] = np.nan
    z[rows // 2 : rows // 2 + 30] = np.nan
    return z


def uneven(rows: int) -> Floats:
    rng = np.random.default_rng(rows)
    return np.where(rng.random(rows) < 0.1, rng.choice([0.0, 0.5, 2.0, 7.0], rows), 1.0)


@pytest.fixture(autouse=True)
def _digits() -> Iterator[None]:
    with localcontext() as context:
        context.prec = 100
        yield


@KINDS
def test_it_is_the_specification(kind: str) -> None:
    """From the first rows, settled or not, across gaps and uneven steps."""
    z, elapsed = rough(900), np.ones(900)
    elapsed[600:] = uneven(300)
    expected, spread, innovation, deviation = exact(COMPONENTS[kind], R, z, elapsed)
    one = channel(COMPONENTS[kind])
    signal, sigma, _, nu, S = one.process(z, elapsed)[:5]
    assert one.settled_row is None or one.settled_row < 300
    judged = np.isfinite(S)
    assert judged.sum() > 800
    assert np.abs((nu - innovation) / deviation)[judged].max() < TWIN
    assert np.abs(S / deviation - 1)[judged].max() < TWIN
    told = np.isfinite(sigma)
    assert told[2 * MOST_STATES :].all()
    assert np.abs((signal - expected) / spread)[told].max() < TWIN
    assert np.abs(sigma / spread - 1)[told].max() < TWIN


@KINDS
def test_its_smoother_is_the_specification(kind: str) -> None:
    """Settled or not, across gaps and uneven steps, at both ends, also where nothing was measured yet."""
    z, elapsed = rough(900), np.ones(900)
    z[:5] = np.nan
    elapsed[600:] = uneven(300)
    expected, spread = exact_smoothed(COMPONENTS[kind], R, z, elapsed)
    signal, sigma = smoothed(COMPONENTS[kind], z, elapsed)
    assert np.abs((signal - expected) / spread).max() < SMOOTHER
    assert np.abs(sigma / spread - 1).max() < SMOOTHER


@pytest.mark.parametrize("gap", [1e-3, 1.0, 4.0])
@pytest.mark.parametrize("order", range(1, 6))
def test_first_rows_before_a_gap_are_smoothed_with_their_digits(order: int, gap: float) -> None:
    """As many readings as there are states come before it, or one fewer: of a model, which never starts anew."""
    part = COMPONENTS[f"order {order}"]
    for early in {order, max(order - 1, 1)}:
        z, elapsed = np.random.default_rng(order).normal(size=early + order + 3), np.ones(early + order + 3)
        elapsed[early] = gap
        expected, spread = exact_smoothed(part, R, z, elapsed)
        found = run_smoother(part.to_model(1.0, R), elapsed_timeline(part, R, elapsed), z[:, np.newaxis])
        assert np.abs((found.signal[:, 0] - expected) / spread).max() < OPENING
        assert np.abs(found.sigma[:, 0] / spread - 1).max() < OPENING


@KINDS
def test_its_likelihood_is_the_specification(kind: str) -> None:
    """From any row on, of any scale: beyond what a product of so many variances could be."""
    z, elapsed = rough(900), np.ones(900)
    elapsed[600:] = uneven(300)
    *_, innovation, deviation = exact(COMPONENTS[kind], R, z, elapsed)
    for begin in (0, 20, 300, 899, 2000):
        foretold = np.isfinite(innovation) & (deviation < 1e6) & (np.arange(900) >= begin)
        found = ChannelRecord(COMPONENTS[kind], R, z, elapsed).score(begin)
        assert found.used == np.count_nonzero(foretold)
        assert found.squares == pytest.approx(((innovation / deviation)[foretold] ** 2).sum(), rel=TWIN)
        assert found.log_det == pytest.approx(2 * np.log(deviation[foretold]).sum(), rel=TWIN, abs=TWIN)


@pytest.mark.parametrize("scale", [1e-120, 1e-60, 1e60, 1e90])
def test_a_likelihood_has_any_unit(scale: float) -> None:
    z = rough(900)
    one, other = (ChannelRecord(motion(2, 1e-4 * k**2), R * k**2, z * k, np.ones(900)).score(3) for k in (1.0, scale))
    assert other.used == one.used
    assert other.squares == pytest.approx(one.squares, rel=1e-9)
    assert other.log_det == pytest.approx(one.log_det + 2 * one.used * np.log(scale), rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
@KINDS
def test_its_first_rows_are_exact_at_uneven_steps(kind: str, seed: int) -> None:
    z, elapsed = rough(24, seed), uneven(24 + seed)[:24] + 0.1
    z[:seed] = np.nan
    expected, spread, *_ = exact(COMPONENTS[kind], R, z, elapsed)
    signal, sigma, _ = run(channel(COMPONENTS[kind]), z, elapsed)
    told = np.isfinite(sigma)
    assert told.sum() > 8
    assert np.abs((signal - expected) / spread)[told].max() < OPENING
    assert np.abs(sigma / spread - 1)[told].max() < OPENING


def everything(rows: int) -> tuple[Floats, Floats, dict[str, Any]]:
    """Return readings with all that can be wrong with them, the steps before them, and a channel's settings."""
    z, elapsed = rough(rows, 7), uneven(rows)
    rng = np.random.default_rng(8)
    z[rng.random(rows) < 0.01] += 40.0
    z[rows // 3 :] += 25.0
    z[rows // 4 : rows // 4 + 12] = z[rows // 4]
    z[[5, rows // 5, 40, 60]] = np.inf, 1e300, 1e6, 5e3
    rule = find_outlier_rule(z[np.isfinite(z) & (np.abs(z) < 1e9)])
    limits = Limits(high=1e6, stuck_readings=8, outliers=rule)
    return z, elapsed, {"limits": limits, "gate": Gate(4.0, 3, 20)}


@KINDS
@given(data=st.data())
@settings(max_examples=10, deadline=None)
def test_any_cut_gives_the_same_bits(kind: str, data: st.DataObject) -> None:
    z, elapsed, more = everything(700)
    whole, parts = channel(COMPONENTS[kind], **more), channel(COMPONENTS[kind], **more)
    expected = stacked(whole.process(z, elapsed))
    cuts = sorted(data.draw(st.lists(st.integers(0, 700), max_size=12)))
    told = [stacked(parts.process(z[a:b], elapsed[a:b])) for a, b in pairwise([0, *cuts, 700])]
    assert_same_bits(np.hstack(told), expected)
    assert parts.state_dict()["state"].tobytes() == whole.state_dict()["state"].tobytes()


@KINDS
def test_it_goes_on_from_its_state(kind: str) -> None:
    z, elapsed, more = everything(600)
    expected = stacked(channel(COMPONENTS[kind], **more).process(z, elapsed))
    for row in (1, 2, 7, 301, 420):
        one, other = channel(COMPONENTS[kind], **more), channel(COMPONENTS[kind], **more)
        run(one, z[:row], elapsed[:row])
        other.load_state_dict(one.state_dict())
        assert_same_bits(stacked(other.process(z[row:], elapsed[row:])), expected[:, row:])


def test_every_verdict_is_given_and_counted() -> None:
    z, elapsed, more = everything(3000)
    one = channel(COMPONENTS["order 1"], **more)
    signal, _, verdicts = run(one, z, elapsed)
    given_ = set(verdicts.tolist())
    assert given_ >= {
        Verdict.USED, Verdict.MISSING, Verdict.NONFINITE, Verdict.OVERRANGE, Verdict.STEP, Verdict.STUCK,
        Verdict.CLIPPED, Verdict.OUTLIER,
    }  # fmt: skip
    counted = np.bincount(verdicts, minlength=len(Verdict))
    assert one.counts == dict(zip(Verdict, counted.tolist(), strict=True))
    assert np.isfinite(signal).all()
    calm = int(np.flatnonzero(verdicts == Verdict.STEP)[0])  # there is no jump before
    assert calm > 100
    without = np.where(LOST[verdicts], np.nan, z)[:calm]
    again, _, _ = run(channel(COMPONENTS["order 1"]), without, elapsed[:calm])
    np.testing.assert_allclose(signal[:calm], again, rtol=1e-9)


@given(
    z=st.lists(st.floats(width=64) | st.sampled_from([np.nan, np.inf, 1e300, 0.0]), min_size=1, max_size=60),
    elapsed=st.lists(st.floats(0, 2.0**52) | st.sampled_from([0.0, 1.0, 1e-9]), min_size=60, max_size=60),
    kind=st.sampled_from(list(COMPONENTS)),
    gated=st.booleans(),
)
@settings(max_examples=150, deadline=None)
def test_nothing_that_is_pushed_breaks_it(z: list[float], elapsed: list[float], kind: str, gated: bool) -> None:
    one = channel(COMPONENTS[kind], gate=Gate(4.0, 3, 20) if gated else None)
    signal, sigma, _ = run(one, np.array(z), np.array(elapsed[: len(z)]))
    assert not (np.isfinite(signal) & ~(sigma >= 0)).any()
    after, _, _ = run(one, np.zeros(4000), np.ones(4000))
    assert np.isfinite(after[-1])


def test_arrays_that_do_not_fit_are_refused() -> None:
    one = channel(COMPONENTS["order 2"])
    for z, elapsed, timing in (
        (np.zeros(3), np.ones(2), None),
        (np.zeros(6)[::2], np.ones(3), None),
        (np.zeros((3, 1)), np.ones(3), None),
        (np.zeros(3), np.ones(3), np.zeros(2, np.int8)),
    ):
        with pytest.raises(ValueError, match=r"in one piece|broadcast"):
            one.process(z, elapsed, timing)


def place_of(field: str) -> int:
    """Return where a field of the packed state of a channel of 2 states is, in bytes."""
    assert STATE.fields is not None
    at, x = (int(STATE.fields[name][1]) for name in (field, "x"))
    if field == "P":
        return x + 8 * 6 * 2  # after six arrays of a number each state
    return at if at <= x else at - STATE.itemsize + PACKED


def state_of(kind: str = "order 2") -> Codes:
    z, elapsed, more = everything(700)
    one = channel(COMPONENTS[kind], **more)
    one.process(z, elapsed)
    state: Codes = one.state_dict()["state"].copy()
    return state


PACKED = len(state_of())


def spoilt(field: str, value: float, kind: str = "i8") -> Codes:
    state = state_of()
    state.view(kind)[place_of(field) // 8] = value
    return state


@pytest.mark.parametrize(
    "state",
    [
        np.zeros(3, np.int8), np.zeros(3), np.full(PACKED, -1, np.int8), np.zeros(PACKED, np.int8),
        state_of("order 3"), spoilt("layout", 1), spoilt("states", 3), spoilt("phase", 3), spoilt("at", 6),
        spoilt("at", -1), spoilt("hops", -1), spoilt("hops", 1 << 62), spoilt("x", np.nan, "f8"),
        spoilt("P", np.inf, "f8"),
    ],
)  # fmt: skip
def test_a_state_that_no_such_channel_can_have_is_refused(state: Any) -> None:
    with pytest.raises(ModelError, match="state of a snapshot"):
        channel(COMPONENTS["order 2"]).load_state_dict({"state": state})


@given(at=st.integers(0, PACKED - 1), flips=st.lists(st.integers(1, 255), min_size=1, max_size=8))
@settings(max_examples=300, deadline=None)
def test_a_damaged_state_is_refused_or_does_no_harm(at: int, flips: list[int]) -> None:
    state = state_of().view(np.uint8)
    state[at : at + len(flips)] ^= np.array(flips[: len(state) - at], np.uint8)
    one = channel(COMPONENTS["order 2"], gate=Gate(4.0, 3, 20))
    try:
        one.load_state_dict({"state": state.view(np.int8)})
    except ModelError:
        return
    one.process(rough(500), uneven(500))


def swing(rows: int) -> Floats:
    t = np.arange(rows)
    return 100 * np.sin(t / 8.0) + np.random.default_rng(2).normal(size=rows)


@pytest.mark.parametrize("lost", [7, 60, 500])
@pytest.mark.parametrize("told", ["by time", "by NaN"])
def test_the_first_reading_after_a_gap_is_no_outlier(lost: int, told: str) -> None:
    z = swing(3000)
    limits = Limits(outliers=find_outlier_rule(z))
    for at in range(1000, 1050):
        if told == "by time":
            rows, elapsed = np.delete(z, slice(at, at + lost)), np.ones(3000 - lost)
            elapsed[at], first = 1 + lost, at
        else:
            rows, elapsed, first = z.copy(), np.ones(3000), at + lost
            rows[at:first] = np.nan
        _, _, verdict, *_ = channel(COMPONENTS["order 1"], limits=limits).process(rows, elapsed)
        assert not (verdict == Verdict.OUTLIER).any()
        rows[first] = 5e4
        _, _, verdict, *_ = channel(COMPONENTS["order 1"], limits=limits).process(rows, elapsed)
        assert np.flatnonzero(verdict == Verdict.OUTLIER).tolist() == [first]


@pytest.mark.parametrize("every", [3, 10])
def test_an_outlier_is_found_where_readings_come_seldom(every: int) -> None:
    z = swing(30_000)[::every].repeat(every)
    z[np.arange(len(z)) % every > 0] = np.nan
    limits = Limits(outliers=find_outlier_rule(z[np.isfinite(z)]))
    if not limits.outliers.causal_distance < 300:
        limits = limits._replace(outliers=limits.outliers._replace(causal_distance=300.0))
    z[600 * every] += 1e4
    _, _, verdict, *_ = channel(COMPONENTS["order 2"], limits=limits).process(z, np.ones(len(z)))
    assert np.flatnonzero(verdict == Verdict.OUTLIER).tolist() == [600 * every]


def test_a_held_reading_is_stuck_though_it_may_fill_in_for_others() -> None:
    z = swing(3000)
    limits = Limits(outliers=find_outlier_rule(z), stuck_readings=6)
    for at in range(1000, 1060):
        held = z.copy()
        held[at:] = held[at]
        _, _, verdict, *_ = channel(COMPONENTS["order 2"], limits=limits).process(held, np.ones(3000))
        assert np.flatnonzero(verdict == Verdict.STUCK)[0] == at + 5


@KINDS
def test_states_make_the_signal_but_for_its_level(kind: str) -> None:
    component, z = COMPONENTS[kind], rough(300)
    found = channel(component).process(z, uneven(300), states=True)
    known = np.isfinite(found.x).all(axis=1)
    assert known.sum() > 250
    level = found.signal - found.x @ component.signal_output[0]
    np.testing.assert_allclose(level[known], z[np.isfinite(z)][0] if component.keeps_level else 0.0, atol=1e-12)
    assert_same_bits(stacked(found), stacked(channel(component).process(z, uneven(300))))


def test_faults_are_told_of_a_hole_too() -> None:
    """A sensor that is stuck in a hole is stuck, though what is told of its rows is that nothing is known."""
    rng = np.random.default_rng(4)
    z, elapsed = rng.normal(size=400), np.ones(400)
    z[100:200], z[300], elapsed[50] = 0.25, np.inf, 6.0
    one = channel(motion(1, 0.1), limits=Limits(stuck_readings=10), hole_sigma=0.5)
    timing = np.where(elapsed > 2.5, np.int8(Verdict.GAP), np.int8(Verdict.USED))
    found = one.process(z, elapsed, timing)
    assert (found.verdict[112:200] == Verdict.HOLE).all()
    assert one.faults == {
        Verdict.NONFINITE: FaultCount(1, 300, 305.0),
        Verdict.STUCK: FaultCount(91, 109, 114.0),
        Verdict.GAP: FaultCount(1, 50, 55.0),
    }
    one.reset_counts()
    assert one.faults == {}
    assert sum(one.counts.values()) == 0


def test_a_timing_that_is_no_verdict_is_refused() -> None:
    for wrong in (127, -1, 16):
        with pytest.raises(ValueError, match="not a Verdict"):
            channel(COMPONENTS["order 1"]).process(np.zeros(3), np.ones(3), np.full(3, wrong, np.int8))


def test_time_that_goes_back_is_refused() -> None:
    for wrong in (np.nan, -1.0):
        with pytest.raises(ValueError, match="steps of 0 or more"):
            channel(COMPONENTS["order 1"]).process(np.zeros(3), np.array([1.0, wrong, 1.0]))


@pytest.mark.parametrize("kind", ["tone", "disturbed", "damped 2", "order 3"])
@pytest.mark.parametrize("row", [1, 2, 3])
@pytest.mark.parametrize("gap", [100.0, 700.0, 982.0, 6000.0, 12000.0, 2e6])
def test_a_gap_among_the_first_rows_locks_nothing_out(kind: str, row: int, gap: float) -> None:
    z, elapsed = np.random.default_rng(3).normal(size=300), np.ones(300)
    elapsed[row] = gap
    for signal, sigma, *_ in (
        channel(COMPONENTS[kind]).process(z, elapsed),
        smoothed(COMPONENTS[kind], z, elapsed),
    ):
        assert np.isfinite(sigma[row + 40 :]).all()
        told = np.isfinite(sigma)
        assert np.abs(signal[told]).max() < 1e3
        assert sigma[told].min() > 1e-3


def test_what_no_sensor_measures_is_missing_at_the_first_row_too() -> None:
    z = rough(200)
    for value in (np.inf, -np.inf, 1e150, np.nan):
        z[0] = value
        signal, sigma = smoothed(COMPONENTS["order 2"], z, np.ones(200))
        assert np.abs(signal).max() < 100
        assert np.isfinite(sigma).all()


def test_too_many_states_are_refused() -> None:
    tones = [oscillator(0.01 * k, 0.01, 1e-3) for k in range(1, 37)]
    component = sum(tones, motion(1, 0.01))
    assert len(component.drift) > MOST_STATES
    with pytest.raises(ModelError, match=f"up to {MOST_STATES} states"):
        channel(component)


def test_a_bias_that_no_reading_sees_stays_apart() -> None:
    """Signal and bias are seen as a sum alone; the sum is known, and no number runs away."""
    signal, sigma, _ = run(channel(motion(1, 0.01) + bias(1e-4)), rough(3000), np.ones(3000))
    assert np.isfinite(signal).all()
    assert np.isfinite(sigma).all()


@pytest.mark.parametrize("struct", [SETTINGS, COEFFICIENTS, STATE], ids=["settings", "coefficients", "state"])
def test_the_fields_of_a_struct_do_not_overlap(struct: np.dtype[np.void]) -> None:
    places = sorted((offset, offset + dtype.itemsize) for dtype, offset, *_ in (struct.fields or {}).values())
    assert all(end <= begin for (_, end), (begin, _) in pairwise(places))
    assert places[-1][1] <= struct.itemsize
