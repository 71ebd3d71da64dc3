"""The library's own channel in C: the bits and the decisions of becalm's stream, whatever comes."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from becalm import native
from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.cleaning.recipes.recipe_parts import CalibrationRecipe, ColouredNoiseRecipe, LimitsRecipe
from becalm.cleaning.streaming.stream import StreamCleaner
from becalm.core.arrays import Codes, Floats
from becalm.core.model.autoregressive import from_partial_autocorrelations
from becalm.core.reading_verdicts import Verdict
from becalm.export.bundle import Bundle, ExportOptions, bundle_of
from becalm.export.channel.kind import Sizes
from becalm.export.channel.sources import sources_of
from becalm.export.proof.compiling import STRICT, build, run
from becalm.export.proof.verifying import write_bundle
from becalm.export.shared_parts import FOLDER
from becalm.export.vectors import STARTING
from carried import BOTH, CHANNELS, GATE, HARD, NUMBERS, STEP_S, USUAL, expected, reference_of, rough
from driven import Driven, driven, driven_one
from exported import ANY, SANITIZED_O0, built, bundle, channel, need, recipe_of

Carries = Callable[[ChannelRecipe, str], Driven]
WATCHED = channel(
    "watched",
    2,
    0.05,
    gate=GATE,
    limits=LimitsRecipe(
        low=-4000.0,
        high=4000.0,
        stuck_readings=12,
        causal_outlier_distance=60.0,
        outlier_distance=60.0,
        plausible_low=-100.0,
        plausible_high=100.0,
        repeats_are_one=True,
        blank=0.0,
        drift_threshold=12.0,
        dead_variance=0.2,
    ),
    spread_std=10.0,
    tuning_spread=0.1,
    calibration=CalibrationRecipe(relative_std=0.01),
)
"""With all that a recipe can say of a sensor."""


SLOW_TONE = HARD["slow tone"].model_copy(update={"spread_std": 1.5, "gate": GATE})
CALIBRATED = CHANNELS["slope"].model_copy(update={"gate": GATE, "calibration": CalibrationRecipe(offset_std=0.5)})
PLAUSIBLE = channel(
    "ax", 2, 0.05, gate=GATE, limits=LimitsRecipe(low=-100.0, high=100.0, plausible_low=-10.0, plausible_high=10.0)
)
DECADES = {
    decade: [channel("ax", order, 10.0 ** (decade / (2 * order)), gate=GATE) for order in (1, 2, 3)]
    for decade in range(-12, 1, 3)
}
"""Process noise over twelve decades."""

TOGETHER = (
    [*BOTH.values(), *HARD.values(), WATCHED, SLOW_TONE, CALIBRATED, PLAUSIBLE],
    [told for each in DECADES.values() for told in each],
)
"""Each compiled into one library; `test_alone_it_compiles_without_a_warning` has some that are alone."""


@pytest.fixture(scope="module")
def carries(tmp_path_factory: pytest.TempPathFactory) -> Carries:
    """Return what gives a channel in a precision as `_init` leaves it, compiled once beside others."""
    folder = tmp_path_factory.mktemp("carries")

    @cache
    def compiled(group: int, precision: str) -> list[Driven]:
        named = [told.model_copy(update={"name": f"c{k}"}) for k, told in enumerate(TOGETHER[group])]
        return list(driven(bundle(*named, precision=precision, gain="full"), folder, "-O1").values())

    def carry(told: ChannelRecipe, precision: str) -> Driven:
        group = 0 if told in TOGETHER[0] else 1
        held = compiled(group, precision)[TOGETHER[group].index(told)]
        held.init()
        return held

    return carry


@pytest.mark.parametrize("name", USUAL)
@pytest.mark.parametrize("precision", NUMBERS)
def test_it_is_the_stream_among_spikes_steps_and_holes(name: str, precision: str, carries: Carries) -> None:
    check(BOTH[name], precision, carries)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*(name for name in BOTH if name not in USUAL), *HARD])
@pytest.mark.parametrize("precision", NUMBERS)
def test_every_channel_is_the_stream(name: str, precision: str, carries: Carries) -> None:
    check({**BOTH, **HARD}[name], precision, carries)


@pytest.mark.slow
@pytest.mark.parametrize("decade", DECADES)
def test_twelve_decades_of_process_noise_are_the_stream(decade: int, carries: Carries) -> None:
    for told in DECADES[decade]:
        check(told, "float64", carries)


def check(told: ChannelRecipe, precision: str, carries: Carries) -> None:
    program = carries(told, precision)
    assert program.one.written.state_bytes == program.size
    for seed in (1, 2):
        readings = rough(told, seed=seed)
        program.init()
        signal, codes = program.run(readings)
        want, became = expected(told, program, readings)
        check_same(precision, signal, codes, want, became)
        if told.gate is not None and told.limits is None:
            assert (codes == Verdict.SPIKE).sum() > 10


def check_same(precision: str, signal: Floats, codes: Codes, want: Floats, became: Codes) -> None:
    np.testing.assert_array_equal(codes, became)
    if precision == "float64":
        np.testing.assert_array_equal(signal, want)
    else:
        np.testing.assert_array_equal(signal, want.astype(np.float32))


@pytest.mark.slow
def test_sixty_six_states_are_the_stream(tmp_path: Path) -> None:
    phi = from_partial_autocorrelations((0.8, *[0.05] * 63))
    noise = ColouredNoiseRecipe(rate_hz=100.0, coefficients=phi, std=3.0)
    told = channel("ar", 2, 0.05, coloured_noise=noise, gate=GATE)
    program, readings = driven_one(bundle(told, precision="float64"), tmp_path, "-O0"), rough(told, 800)
    check_same("float64", *program.run(readings), *expected(told, program, readings))


@pytest.mark.parametrize("name", ["slope", "gated bend", "gated hum", "returning"])
def test_where_the_stream_tells_something_it_is_told(name: str, carries: Carries) -> None:
    """The reference only adds what a controller is told where the stream is silent."""
    told = BOTH[name]
    program, readings = carries(told, "float64"), rough(told)
    readings[:3], readings[500:900] = np.nan, np.nan
    signal, codes = program.run(readings)
    found = StreamCleaner(recipe_of(told), STEP_S).push(readings[:, np.newaxis], np.ones(len(readings)))
    told_by_it = np.isfinite(found.signal[:, 0])
    np.testing.assert_array_equal(signal[told_by_it], found.signal[told_by_it, 0])
    starting = codes == STARTING
    np.testing.assert_array_equal(codes[~starting], found.verdicts[~starting, 0])
    np.testing.assert_array_equal(signal[starting], readings[starting])
    assert not told_by_it[starting].any()


@pytest.mark.parametrize("precision", NUMBERS)
def test_all_that_a_recipe_says_of_a_sensor_is_heeded(precision: str, carries: Carries) -> None:
    """Gross outliers, fills, rests, holes, drift, a dead sensor, and what a calibration adds to sigma."""
    program, rng = carries(WATCHED, precision), np.random.default_rng(5)
    readings = 3 * np.sin(np.arange(6000) / 60) + rng.normal(size=6000)
    readings[[700, 2000, 2001, 3300]] = 5e4, -3e3, 2e3, np.inf
    readings[[900, 901, 950]] = 0.0
    readings[1200:1230] = readings[1200]
    readings[1500:2000] = np.nan
    readings[2500:2900] += np.arange(400) / 4
    readings[3000:3010] = 5000.0
    readings[4000:4800] = 2.0 + 1e-3 * rng.normal(size=800)
    signal, codes = program.run(readings)
    given_it = program.rounded(readings)
    check_same(precision, signal, codes, *expected(WATCHED, program, readings))
    met = {Verdict(code) for code in codes.tolist() if code != STARTING}
    assert {Verdict.OUTLIER, Verdict.STUCK, Verdict.HOLE, Verdict.CLIPPED, Verdict.NONFINITE, Verdict.DEAD} <= met
    stream = StreamCleaner(recipe_of(WATCHED), STEP_S)
    sigma = stream.push(given_it[:, np.newaxis], np.ones(len(readings))).sigma[-1, 0]
    assert program.sigma == pytest.approx(sigma, rel=0 if precision == "float64" else 1e-7)


def test_a_wild_first_reading_is_no_start(carries: Carries) -> None:
    program = carries(WATCHED, "float64")
    signal, codes = program.run(np.concatenate([[65535.0], 10 + np.random.default_rng(1).normal(size=100)]))
    assert codes[0] == Verdict.CLIPPED
    assert signal[0] == 0.0
    assert np.abs(signal[1:] - 10).max() < 5


@pytest.mark.parametrize("name", ["bend", "gated railed", "never"])
@pytest.mark.parametrize("rows", [1, 63, 64, 65, 200, 1000])
def test_a_gap_at_once_is_one_row_by_row(name: str, rows: int, carries: Carries) -> None:
    program = carries(BOTH[name], "float64")
    before, after = np.clip(rough(BOTH[name]), -59, 59)[:700], np.clip(rough(BOTH[name], seed=9), -59, 59)[:700]
    program.run(before)
    program.gap(rows)
    (at_once, codes), sigma = program.run(after), program.sigma
    program.init()
    program.run(np.concatenate([before, np.full(rows, np.nan)]))
    one_by_one, became = program.run(after)
    np.testing.assert_array_equal(codes, became)
    assert np.abs(at_once - one_by_one).max() <= 1e-12 * np.abs(one_by_one).max()
    assert sigma == pytest.approx(program.sigma, rel=1e-12)
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
    signal, codes = program.run(readings)
    reference = reference_of(CHANNELS["snap"], program)
    reference.run(program.rounded(before))
    reference.gap(longest - 1 + beyond)
    np.testing.assert_array_equal(codes, reference.run(program.rounded(readings))[1])
    assert (signal[0] == program.rounded(readings)[0]) is np.bool_(beyond)


@pytest.mark.parametrize("precision", NUMBERS)
def test_endless_gaps_leave_numbers(precision: str, carries: Carries) -> None:
    for name in ("never", "coloured", "snap"):
        program = carries(CHANNELS[name], precision)
        for _ in range(30):
            program.run(rough(CHANNELS[name])[:50])
            program.gap((1 << 32) - 1)
            assert program.sigma > 0
            signal, _ = program.run(np.full(3, np.nan))
            assert np.isfinite(signal).all()
        signal, _ = program.run(np.ones(4000))
        assert np.isfinite(signal).all()
        if name != "never":  # which forgets nothing
            assert abs(signal[-1] - 1.0) < 1e-3


@pytest.mark.parametrize("first", [1, 3, 5, 9])
def test_a_hole_among_the_first_readings_is_told_as_becalm_predicts(first: int, carries: Carries) -> None:
    """While the state is gathered as information it is no state yet."""
    program = carries(SLOW_TONE, "float64")
    readings = np.concatenate([20 + np.random.default_rng(first).normal(size=first), np.full(60, np.nan)])
    check_same("float64", *program.run(readings), *expected(SLOW_TONE, program, readings))


def test_a_reset_is_as_if_it_had_been_so_for_ever(carries: Carries) -> None:
    """A jump soon after moves the level alone, and sigma knows of the calibration."""
    program = carries(CALIBRATED, "float64")
    long, jumped = np.zeros(5000), np.full(30, 50.0)
    after_long = program.run(np.concatenate([long, jumped]))[0][len(long) :]
    sigma = program.sigma
    program.reset(0.0)
    assert program.sigma > 0.5
    np.testing.assert_allclose(program.run(jumped)[0], after_long, atol=1e-9)
    assert program.sigma == pytest.approx(sigma, rel=1e-9)


@pytest.mark.parametrize("name", ["bend", "snap"])
@pytest.mark.parametrize("rows", [1 << 18, (1 << 32) - 1])
def test_a_reset_is_forgotten_over_a_gap_beyond_reach(name: str, rows: int, carries: Carries) -> None:
    program = carries(CHANNELS[name], "float64")
    program.reset(1000.0)
    program.gap(rows)
    signal, _ = program.run(1000 + np.random.default_rng(2).normal(size=3000))
    assert np.abs(signal - 1000).max() < 10


@pytest.mark.parametrize("signal", [60.1, -1e3, 1e50, 1e99, np.inf])
def test_a_reset_to_what_is_no_reading_is_none(signal: float, carries: Carries) -> None:
    program = carries(BOTH["gated railed"], "float64")
    program.reset(signal)
    assert program.sigma == np.inf
    told, codes = program.run(np.array([np.nan, 1.0]))
    assert told.tolist() == [0.0, 1.0]
    assert codes[0] == Verdict.MISSING


def test_a_reading_that_is_none_does_not_stand_in_for_an_estimate_that_ran_away(carries: Carries) -> None:
    program, readings = carries(PLAUSIBLE, "float64"), np.minimum(np.arange(400) / 10, 30.0)
    readings[330:360] = np.nan
    readings[[340, 345, 350]] = 4095.0, np.inf, np.nan
    signal, codes = program.run(readings)
    check_same("float64", signal, codes, *expected(PLAUSIBLE, program, readings))
    assert np.abs(signal).max() < 200


@pytest.mark.parametrize("name", ["slope", "never", "returning", "watched"])
def test_a_reset_knows_the_level(name: str, carries: Carries) -> None:
    for precision in NUMBERS:
        program = carries(WATCHED if name == "watched" else CHANNELS[name], precision)
        program.run(rough(CHANNELS["slope"]))
        program.reset(64.5)
        assert 0 < program.sigma < 3
        signal, codes = program.run(np.full(10, 64.5))
        assert (codes == Verdict.USED).all()
        np.testing.assert_allclose(signal, 64.5, rtol=1e-12)
        program.reset(float("nan"))
        assert program.sigma == np.inf
        assert program.run(np.array([np.nan]))[0][0] == 0.0


def test_sigma_is_that_of_the_stream(carries: Carries) -> None:
    told = CHANNELS["coloured"]
    program, readings = carries(told, "float64"), rough(told)
    stream = StreamCleaner(recipe_of(told), STEP_S)
    assert program.sigma == np.inf
    for row in range(1500):
        program.run(readings[row : row + 1])
        assert program.sigma == stream.push(readings[row : row + 1, np.newaxis], np.ones(1)).sigma[0, 0]


def test_readings_of_a_rounded_step_are_followed_as_becalm_does(carries: Carries) -> None:
    """A jump whose square is a power of four, and next to one: what is added must not hang on a last digit."""
    told = BOTH["gated slope"]
    for precision in NUMBERS:
        program = carries(told, precision)
        for size in (64.0, 128.0, 1000.0, 1e6, 4096.0):
            readings = np.where(np.arange(400) < 200, 3.3, 3.3 + size)
            program.init()
            signal, codes = program.run(readings)
            check_same(precision, signal, codes, *expected(told, program, readings))
            assert (codes == Verdict.STEP).sum() == 1


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.tuples(ANY, st.sampled_from([0, 0, 0, 1, 70, 5000, (1 << 32) - 1])), min_size=1, max_size=60),
    st.sampled_from(["slope", "gated snap", "gated hum", "gated never", "gated railed", "watched"]),
    st.sampled_from(sorted(NUMBERS)),
)
def test_nothing_makes_a_state_infinite(
    carries: Carries, wild: list[tuple[float, int]], name: str, precision: str
) -> None:
    program = carries({**BOTH, "watched": WATCHED}[name], precision)
    for reading, gap in wild:
        signal, codes = program.run(np.array([reading]))
        assert np.isfinite(signal).all()
        assert codes[0] != Verdict.USED or np.isfinite(reading)
        if gap:
            program.gap(gap)
        assert program.sigma > 0
    signal, codes = program.run(10 + np.random.default_rng(3).normal(size=4000))
    assert np.isfinite(signal).all()
    used = float((codes[-1000:] == Verdict.USED).mean())
    assert used > (0.9 if name == "gated never" else 0.99)  # without process noise nothing wild is ever forgotten
    assert np.abs(signal[-500:] - 10).max() < 10


@pytest.mark.parametrize(
    ("compiler", "flags", "precision"),
    [
        ("gcc", SANITIZED_O0, "float32"),
        ("clang", SANITIZED_O0, "float64"),
        pytest.param("gcc", ("-O3",), "float64", marks=pytest.mark.slow),
        pytest.param("clang", ("-O2",), "float32", marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_the_golden_vectors_pass(compiler: str, flags: tuple[str, ...], precision: str, tmp_path: Path) -> None:
    """Each compiler in both precisions; gcc at -O2 compiles other tests."""
    need(compiler)
    made = usual_and_hard(precision)
    ran = run(built(made, tmp_path, compiler, flags))
    assert (ran.returncode, ran.stdout.count("passed:")) == (0, 10 * len(made.channels)), ran.stdout + ran.stderr


@cache
def usual_and_hard(precision: str) -> Bundle:
    tried = [*(BOTH[name] for name in USUAL), *HARD.values(), WATCHED]
    chosen = [told.model_copy(update={"name": f"c{k}"}) for k, told in enumerate(tried)]
    return bundle(*chosen, precision=precision, gain="full")


@pytest.mark.parametrize("flags", [("-O0",), ("-O3",)], ids="".join)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_every_compiler_gives_the_bits_of_the_library(compiler: str, flags: tuple[str, ...], tmp_path: Path) -> None:
    program = driven_one(bundle(WATCHED, precision="float64"), tmp_path, *flags, compiler=compiler)
    readings = rough(WATCHED)
    check_same("float64", *program.run(readings), *expected(WATCHED, program, readings))


@pytest.mark.parametrize(("name", "flags"), [("level", "-O3"), ("gated slope", "-O2"), ("gated snap", "-O3")])
def test_alone_it_compiles_without_a_warning(name: str, flags: str, tmp_path: Path) -> None:
    """Arrays are as large as its states: a compiler sees more of them than in the library."""
    assert run(built(bundle(BOTH[name], gain="full"), tmp_path, "gcc", (flags,))).returncode == 0


@pytest.mark.parametrize("flag", ["-ffast-math", "-ffinite-math-only"])
def test_it_is_not_compiled_where_nan_is_forgotten(flag: str, tmp_path: Path) -> None:
    need("gcc")
    place, words = write_bundle(bundle(WATCHED), tmp_path), ["gcc", flag, "-c", "drive.c"]
    ran = subprocess.run(words, cwd=place, capture_output=True, text=True, check=False)
    assert ran.returncode
    assert "-ffast-math assumes that there is no NaN: compile without it" in ran.stderr


def test_what_is_shipped_is_the_library() -> None:
    """Every file but the one that says how large arrays are; and every file that one of them includes."""
    texts, sources = sources_of(Sizes(frozenset({2, 3}), frozenset({2}), 4), "drive"), Path(native.__file__).parent
    for path, text in texts.items():
        folder, name = path.split("/")
        assert folder == FOLDER
        assert name == "sizes.h" or text == (sources / name).read_text()
        included = {line.split('"')[1] for line in text.splitlines() if line.startswith('#include "')}
        assert {f"{FOLDER}/{other}" for other in included} <= set(texts)
    files = bundle(WATCHED, gain="full").files
    assert f"{FOLDER}/imm.c" in texts
    assert f"{FOLDER}/imm.c" not in files
    assert f"{FOLDER}/filter.c" in files
    assert not any(path.startswith(FOLDER) for path in bundle(CHANNELS["slope"], gain="settled").files)


FIFTY = """{
    STEM_a_state s;
    double y;
    STEM_a_init(&s);
    for (int k = 0; k < 50; k++) STEM_a_step(&s, k * 0.1, &y);
    printf("%.17g\\n", y);
}
"""


def test_two_exports_are_linked_into_one_program(tmp_path: Path) -> None:
    """Their arrays are of other sizes: neither may call the other's functions."""
    need("gcc")
    told = {"one": channel("a", 2, 0.05, gate=GATE), "other": channel("a", 5, 0.3, gate=GATE)}
    main = ["#include <stdio.h>"]
    for stem, recipe in told.items():
        folder = tmp_path / stem
        folder.mkdir()
        made = bundle_of(recipe_of(recipe), stem, ExportOptions(precision="float64"))
        texts = [f"{stem}.c", *(path for path in made.files if path.startswith(FOLDER) and path.endswith(".c"))]
        subprocess.run(["gcc", *STRICT, "-c", *texts], cwd=write_bundle(made, folder), check=True)
        main.append(f'#include "{stem}/{stem}.h"')
    calls = "".join(FIFTY.replace("STEM", stem) for stem in told)
    (tmp_path / "main.c").write_text("\n".join([*main, f"int main(void) {{ {calls} return 0; }}"]))
    objects = [str(path) for path in tmp_path.glob("*/*.o")]
    subprocess.run(["gcc", "main.c", *objects, "-o", "main", "-lm"], cwd=tmp_path, check=True)
    said = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout.split()
    z: Floats = np.arange(50, dtype=np.float64) * 0.1
    for recipe, signal in zip(told.values(), said, strict=True):
        stream = StreamCleaner(recipe_of(recipe), STEP_S)
        assert float(signal) == stream.push(np.asarray(z[:, np.newaxis], np.float64), np.ones(50)).signal[-1, 0]


@pytest.mark.parametrize("stem", ["filter", "device", "channel", "becalm", "becalm_sizes", "imm"])
def test_a_recipe_may_be_called_as_a_part_of_the_library(stem: str, tmp_path: Path) -> None:
    need("gcc")
    made = bundle_of(recipe_of(WATCHED.model_copy(update={"name": "加速度"})), stem, ExportOptions())
    ran = run(build(write_bundle(made, tmp_path), made.stem, "gcc", ("-O0",)))
    assert ran.returncode == 0, ran.stdout


def test_a_channel_far_from_0_is_tried_where_it_is(tmp_path: Path) -> None:
    limits = LimitsRecipe(outlier_distance=5.0, causal_outlier_distance=5.0, plausible_low=13.0, plausible_high=90.0)
    made = bundle(channel("volt", 2, 0.05, limits=limits, gate=GATE), precision="float64")
    (one,) = made.channels
    ran = run(built(made, tmp_path))
    assert ran.returncode == 0, ran.stdout
    used = {vector.name: np.isin(vector.codes, [Verdict.USED, Verdict.STEP]).mean() for vector in one.vectors}
    assert min(used.values()) > 0.5


def test_outliers_ask_for_the_whole_channel() -> None:
    def kind(**asked: Any) -> str:
        return type(bundle(WATCHED.model_copy(update={"gate": None}), **asked).channels[0].kind).__name__

    assert kind() == "WholeChannel"
    assert kind(gain="settled") == "Settled"
