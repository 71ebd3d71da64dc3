"""A filter with its full covariance in C: the numbers and the decisions of becalm's stream, whatever comes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from becalm.cleaning.recipe import ChannelRecipe
from becalm.cleaning.recipe_parts import ColouredNoiseRecipe
from becalm.cleaning.stream import StreamCleaner
from becalm.core.autoregressive import from_partial_autocorrelations
from becalm.core.verdict import Verdict
from becalm.export.bundle import Bundle
from becalm.export.design import design_of
from becalm.export.factors import factors_of
from becalm.export.full.kind import Full
from becalm.export.number_type import DOUBLE, FLOAT
from becalm.export.proof.compiling import run
from becalm.export.vectors import STARTING
from carried import BOTH, CHANNELS, GATE, HARD, NUMBERS, STEP_S, USUAL, expected, reference_of, rough
from driven import Driven, driven_one
from exported import ANY, EVERY_BUILD, built, bundle, channel, need, recipe_of, snr_db

Carries = Callable[[ChannelRecipe, str], Driven]


@pytest.fixture(scope="module")
def carries(tmp_path_factory: pytest.TempPathFactory) -> Carries:
    """Return what compiles a channel in a precision, once, and gives it as `_init` leaves it."""
    folder, made = tmp_path_factory.mktemp("carries"), dict[tuple[str, str], Driven]()

    def carry(told: ChannelRecipe, precision: str) -> Driven:
        key = told.model_dump_json(), precision
        if key not in made:
            made[key] = driven_one(bundle(told, precision=precision, gain="full"), folder)
        made[key].init()
        return made[key]

    return carry


@pytest.mark.parametrize("name", USUAL)
@pytest.mark.parametrize("precision", NUMBERS)
def test_it_is_the_stream_among_spikes_steps_and_holes(name: str, precision: str, carries: Carries) -> None:
    check(BOTH[name], precision, carries)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in BOTH if name not in USUAL])
@pytest.mark.parametrize("precision", NUMBERS)
def test_every_channel_is_the_stream(name: str, precision: str, carries: Carries) -> None:
    check(BOTH[name], precision, carries)


@pytest.mark.slow
@pytest.mark.parametrize("decade", range(-12, 1))
@pytest.mark.parametrize("precision", NUMBERS)
def test_twelve_decades_of_process_noise_are_the_stream(decade: int, precision: str, carries: Carries) -> None:
    for order in (1, 2, 3):
        check(channel("ax", order, 10.0 ** (decade / (2 * order)), gate=GATE), precision, carries)


def check(told: ChannelRecipe, precision: str, carries: Carries) -> None:
    program = carries(told, precision)
    assert program.one.written.state_bytes == program.size
    for seed in (1, 2):
        readings = rough(told, seed=seed)
        program.init()
        signal, codes = program.run(readings)
        want, became = expected(told, program, readings)
        np.testing.assert_array_equal(codes, became)
        if told.gate is not None and told.limits is None:
            assert (codes == Verdict.SPIKE).sum() > 10
        if precision == "float64":
            assert np.abs(signal - want).max() <= 1e-12 * np.abs(want).max()
        else:
            assert snr_db(signal, want) >= 120


@pytest.mark.slow
def test_sixty_six_states_are_the_stream(carries: Carries) -> None:
    phi = from_partial_autocorrelations((0.8, *[0.05] * 63))
    noise = ColouredNoiseRecipe(rate_hz=100.0, coefficients=phi, std=3.0)
    told = channel("ar", 2, 0.05, coloured_noise=noise, gate=GATE)
    program, readings = carries(told, "float64"), rough(told, 800)
    signal, codes = program.run(readings)
    want, became = expected(told, program, readings)
    np.testing.assert_array_equal(codes, became)
    assert np.abs(signal - want).max() <= 1e-12 * np.abs(want).max()


@pytest.mark.parametrize("name", ["bend", "gated railed", "never"])
@pytest.mark.parametrize("rows", [1, 63, 64, 65, 200, 1000])
def test_a_gap_at_once_is_one_row_by_row(name: str, rows: int, carries: Carries) -> None:
    program = carries(BOTH[name], "float64")
    before, after = np.clip(rough(BOTH[name]), -59, 59)[:700], np.clip(rough(BOTH[name], seed=9), -59, 59)[:700]
    program.run(before)
    program.gap(rows)
    (at_once, codes), variance = program.run(after), program.variance
    program.init()
    program.run(np.concatenate([before, np.full(rows, np.nan)]))
    one_by_one, became = program.run(after)
    np.testing.assert_array_equal(codes, became)
    assert np.abs(at_once - one_by_one).max() <= 1e-12 * np.abs(one_by_one).max()
    assert variance == pytest.approx(program.variance, rel=1e-12)
    reference = reference_of(BOTH[name], program)
    reference.run(before)
    reference.gap(rows)
    want, became = reference.run(after)
    np.testing.assert_array_equal(codes, became)
    assert np.abs(at_once - want).max() <= 1e-12 * np.abs(want).max()


@pytest.mark.parametrize("beyond", [0, 1])
@pytest.mark.parametrize("precision", NUMBERS)
def test_a_gap_beyond_reach_begins_anew(precision: str, beyond: int, carries: Carries) -> None:
    program = carries(CHANNELS["snap"], precision)
    longest, readings = program.one.design.longest_gap, rough(CHANNELS["snap"])[:600]
    assert 100 < longest < 1000
    before = 1.0 + np.sin(np.arange(300))
    program.run(before)
    program.gap(longest - 1 + beyond)
    codes = program.run(readings)[1]
    reference = reference_of(CHANNELS["snap"], program)
    reference.run(program.rounded(before))
    reference.gap(longest - 1 + beyond)
    np.testing.assert_array_equal(codes, reference.run(program.rounded(readings))[1])
    assert codes[0] == (STARTING if beyond else Verdict.USED)


@pytest.mark.parametrize("precision", NUMBERS)
def test_endless_gaps_leave_numbers(precision: str, carries: Carries) -> None:
    for name in ("never", "coloured", "snap"):
        program = carries(CHANNELS[name], precision)
        for _ in range(30):
            program.run(rough(CHANNELS[name])[:50])
            program.gap((1 << 32) - 1)
            assert np.isfinite(program.variance)
            signal, _ = program.run(np.full(3, np.nan))
            assert np.isfinite(signal).all()
        signal, _ = program.run(np.ones(4000))
        assert np.isfinite(signal).all()
        if name != "never":  # which forgets nothing
            assert abs(signal[-1] - 1.0) < 1e-3


@pytest.mark.parametrize("name", ["slope", "never"])
def test_a_reset_knows_the_level(name: str, carries: Carries) -> None:
    for precision in NUMBERS:
        program = carries(CHANNELS[name], precision)
        program.run(rough(CHANNELS[name]))
        program.reset(1234.5)
        signal, codes = program.run(np.full(200, 1234.5))
        assert (codes == Verdict.USED).all()
        np.testing.assert_allclose(signal, 1234.5, rtol=1e-12)
        program.reset(float("nan"))
        assert program.run(np.array([np.nan]))[0][0] == 0.0


def test_the_variance_is_that_of_the_stream(carries: Carries) -> None:
    told = CHANNELS["coloured"]
    program, readings = carries(told, "float64"), rough(told)
    stream = StreamCleaner(recipe_of(told), STEP_S)
    assert program.variance > 1e299
    for row in range(1500):
        program.run(readings[row : row + 1])
        sigma = stream.push(readings[row : row + 1, np.newaxis], np.ones(1)).sigma[0, 0]
        if row >= 5:
            assert program.variance == pytest.approx(sigma**2, rel=1e-10)


def test_a_first_reading_that_is_missing_begins_it_anew(carries: Carries) -> None:
    told = CHANNELS["bend"]
    program = carries(told, "float64")
    readings = np.array([np.nan, 1.0, 2.0, np.nan, np.nan, 3.0, 4.0, 6.0, 7.0, np.nan, 9.0])
    signal, codes = program.run(readings)
    want, became = expected(told, program, readings)
    np.testing.assert_array_equal(codes, became)
    assert codes.tolist() == [1, 32, 32, 1, 1, 32, 32, 0, 0, 1, 0]
    assert signal[:7].tolist() == [0.0, 1.0, 2.0, 1.0, 1.0, 3.0, 4.0]
    np.testing.assert_allclose(signal, want, rtol=0, atol=1e-13)


def test_readings_of_a_rounded_step_are_followed_as_becalm_does(carries: Carries) -> None:
    """A jump whose square is a power of four, and next to one: what is added must not hang on a last digit."""
    told = BOTH["gated slope"]
    for precision in NUMBERS:
        program = carries(told, precision)
        for size in (64.0, 128.0, 1000.0, 1e6, 4096.0):
            readings = np.where(np.arange(400) < 200, 3.3, 3.3 + size)
            program.init()
            signal, codes = program.run(readings)
            want, became = expected(told, program, readings)
            np.testing.assert_array_equal(codes, became)
            assert (codes == Verdict.STEP).sum() == 1
            assert snr_db(signal, want) >= 120


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.tuples(ANY, st.sampled_from([0, 0, 0, 1, 70, 5000, (1 << 32) - 1])), min_size=1, max_size=60),
    st.sampled_from(["slope", "gated snap", "gated hum", "gated never", "gated railed"]),
    st.sampled_from(sorted(NUMBERS)),
)
def test_nothing_makes_a_state_infinite(
    carries: Carries, wild: list[tuple[float, int]], name: str, precision: str
) -> None:
    program = carries(BOTH[name], precision)
    for reading, gap in wild:
        signal, codes = program.run(np.array([reading]))
        assert np.isfinite(signal).all()
        assert codes[0] != Verdict.USED or np.isfinite(reading)
        if gap:
            program.gap(gap)
        assert np.isfinite(program.variance)
    signal, codes = program.run(10 + np.random.default_rng(3).normal(size=4000))
    assert np.isfinite(signal).all()
    used = float((codes[-1000:] == Verdict.USED).mean())
    assert used > (0.9 if name == "gated never" else 0.99)  # without process noise nothing wild is ever forgotten
    assert np.abs(signal[-500:] - 10).max() < 10


@pytest.mark.parametrize("precision", NUMBERS)
def test_the_golden_vectors_pass(precision: str, tmp_path: Path) -> None:
    chosen = [BOTH[name].model_copy(update={"name": f"c{k}"}) for k, name in enumerate(USUAL)]
    made = bundle(*chosen, precision=precision, gain="full")
    ran = run(built(made, tmp_path))
    assert (ran.returncode, ran.stdout.count("passed:")) == (0, 10 * len(chosen)), ran.stdout


@pytest.mark.slow
@EVERY_BUILD
@pytest.mark.parametrize("precision", NUMBERS)
def test_every_compiler_agrees(precision: str, compiler: str, flags: tuple[str, ...], tmp_path: Path) -> None:
    need(compiler)
    made = usual_and_hard(precision)
    ran = run(built(made, tmp_path, compiler, flags))
    assert (ran.returncode, ran.stdout.count("passed:")) == (0, 10 * len(made.channels)), ran.stdout + ran.stderr


@cache
def usual_and_hard(precision: str) -> Bundle:
    tried = [*(BOTH[name] for name in USUAL), *HARD.values()]
    chosen = [told.model_copy(update={"name": f"c{k}"}) for k, told in enumerate(tried)]
    return bundle(*chosen, precision=precision, gain="full")


@pytest.mark.parametrize("name", HARD)
def test_what_becalm_rounds_away_c_keeps(name: str, carries: Carries) -> None:
    """Models whose covariance has few digits: becalm's stream is further from its equations than C is."""
    program, readings = carries(HARD[name], "float64"), rough(HARD[name])
    signal, codes = program.run(readings)
    own, digits, became = reference_of(HARD[name], program).both(readings)
    np.testing.assert_array_equal(codes, became)
    size = np.abs(digits).max()
    assert np.abs(own - digits).max() > 3 * np.abs(signal - digits).max()
    assert np.abs(own - digits).max() < 1e-8 * size
    assert np.abs(signal - digits).max() <= 1e-12 * size


def test_more_digits_are_those_of_becalm(carries: Carries) -> None:
    program, readings = carries(BOTH["gated slope"], "float64"), rough(CHANNELS["slope"])
    own, digits, _ = reference_of(BOTH["gated slope"], program).both(readings)
    assert np.abs(own - digits).max() <= 1e-13 * np.abs(own).max()


def test_factors_are_those_of_their_covariance() -> None:
    rng = np.random.default_rng(5)
    A = rng.normal(size=(6, 4))
    for P in (A @ A.T, np.diag([1.0, 0.0, 2.0]), np.zeros((2, 2))):
        U, D = factors_of(P)
        np.testing.assert_allclose(U * D @ U.T, P, atol=1e-13)
        assert (np.tril(U, -1) == 0).all()
        assert (D >= 0).all()


def test_float_holds_the_state_only_where_that_costs_nothing() -> None:
    def held(told: ChannelRecipe) -> bool:
        design = design_of(told, STEP_S)
        assert design is not None
        return "float x[" in Full(FLOAT).write(design, "f", None).header

    assert held(CHANNELS["slope"])
    assert held(BOTH["gated bend"])
    assert not any(held(CHANNELS[name]) for name in ("slow", "never", "snap"))


def test_the_reference_is_becalms_stream_itself() -> None:
    """Without holes among the first readings nothing but the names of what is not known yet differs."""
    told, readings = BOTH["gated slope"], rough(BOTH["gated slope"])
    readings[:10] = 1.0
    design = design_of(told, STEP_S)
    assert design is not None
    kind = Full(DOUBLE)
    signal, codes = kind.reference(told, design, kind.write(design, "f", None)).run(readings)
    found = StreamCleaner(recipe_of(told), STEP_S).push(readings[:, np.newaxis], np.ones(len(readings)))
    np.testing.assert_array_equal(signal, found.signal[:, 0])
    np.testing.assert_array_equal(codes[1:], found.verdicts[1:, 0])
