"""A settled filter in C: becalm's numbers, whatever comes, however it is compiled."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.core.reading_verdicts import Verdict
from becalm.errors import RecipeError
from becalm.export.design import design_of
from becalm.export.number_type import DOUBLE, FLOAT
from becalm.export.proof.compiling import CompileError, run
from becalm.export.schedule import schedule_of
from becalm.export.settled.reference import SettledReference
from becalm.export.settled.text import schedule_in, write_with_gains
from becalm.export.settled.word_length import choose_word_length
from becalm.export.vectors import STARTING
from becalm.export.word_length import WordLength, stall_of, ulp
from driven import UNDEFINED, Driven, driven
from exported import (
    ANY,
    BUILDS,
    HUM,
    LIMITS,
    TONE,
    built,
    bundle,
    channel,
    live,
    need,
    snr_db,
    through,
    wandering,
)

PRECISIONS = ("float32", "float64")
CHANNELS = {
    "level": channel("level", 1, 0.2),
    "slope": channel("slope", 2, 0.05),
    "bend": channel("bend", 3, 0.05),
    "snap": channel("snap", 5, 0.2),
    "returning": channel("returning", 2, 0.05, damped_below_hz=0.1),
    "tone": channel("tone", 2, 0.05, tone=(TONE,)),
    "hum": channel("hum", 1, 0.05, tone=(HUM,)),
    "railed": channel("railed", 2, 0.05, limits=LIMITS),
}


@pytest.mark.parametrize("told", CHANNELS.values(), ids=CHANNELS)
def test_the_specification_is_the_stream_where_no_reading_is_missing(told: ChannelRecipe) -> None:
    (one,) = bundle(told, precision="float64").channels
    readings = np.clip(wandering(3000), -59, 59)
    signal, codes = one.kind.reference(told, one.design, one.written).run(readings)
    want = live(one, told, readings)
    known = codes != STARTING
    assert known.sum() > 2900
    off = np.abs(signal - want)[known] / np.abs(want[known]).max()
    assert off[200:].max() <= 1e-12
    assert off.max() <= 1e-11  # the weights of first readings, which hardly tell a tone, keep eleven digits


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_golden_vectors_pass(precision: str, tmp_path: Path) -> None:
    made = bundle(*CHANNELS.values(), precision=precision)
    ran = run(built(made, tmp_path))
    assert ran.returncode == 0, ran.stdout
    assert ran.stdout.count("passed:") == sum(len(one.vectors) + 1 for one in made.channels) == 10 * len(CHANNELS)


@pytest.mark.slow
@pytest.mark.parametrize(("compiler", "flags"), BUILDS, ids=str)
def test_every_compiler_agrees(compiler: str, flags: tuple[str, ...], tmp_path: Path) -> None:
    """In the precisions by turns: a compiler is told of types by its warnings, which -O2 shows in both."""
    need(compiler)
    precision = PRECISIONS[BUILDS.index((compiler, flags)) % 2]
    made = bundle(*(told for told in CHANNELS.values() if is_settled(told, precision)), precision=precision)
    assert len(made.channels) > len(CHANNELS) // 2
    ran = run(built(made, tmp_path, compiler, flags))
    assert ran.returncode == 0, ran.stdout + ran.stderr


def is_settled(told: ChannelRecipe, precision: str) -> bool:
    """Return whether a channel is written so, and not, as orders 4 and 5 in float, as the library's own."""
    return not bundle(told, precision=precision).needs_nan


def test_a_wrong_number_fails_a_vector(tmp_path: Path) -> None:
    made = bundle(CHANNELS["slope"])
    (gain,) = made.channels[0].design.steady.gain[:1, 0]  # type: ignore[union-attr]
    texts = made.files["drive.c"]
    wrong = made._replace(
        files={**made.files, "drive.c": texts.replace(FLOAT.literal(gain), FLOAT.literal(gain * 1.001))}
    )
    assert wrong.files["drive.c"] != texts
    ran = run(built(wrong, tmp_path))
    assert ran.returncode == 1
    assert "FAILED" in ran.stdout


def test_the_same_recipe_gives_the_same_bytes() -> None:
    assert bundle(*CHANNELS.values()).files == bundle(*CHANNELS.values()).files


@pytest.mark.parametrize(("precision", "least_db"), [("float32", 120.0), ("float64", 240.0)])
def test_long_records_agree_with_the_stream(precision: str, least_db: float, tmp_path: Path) -> None:
    told = [CHANNELS["slope"], CHANNELS["level"]]
    made = bundle(*told, precision=precision)
    program, readings = built(made, tmp_path), wandering(100_000)
    for one, recipe in zip(made.channels, told, strict=True):
        signal, codes = through(program, one, readings)
        known = codes != STARTING
        assert one.written.exact
        assert snr_db(signal[known], live(one, recipe, readings)[known]) >= least_db


@pytest.fixture(scope="module")
def held_ones(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Driven]]:
    """Compile all channels in each precision."""
    folder = tmp_path_factory.mktemp("held")
    return {each: driven(bundle(*CHANNELS.values(), precision=each), folder, *UNDEFINED) for each in PRECISIONS}


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(ANY, min_size=1, max_size=200), st.sampled_from(sorted(CHANNELS)), st.sampled_from(PRECISIONS))
def test_nothing_makes_a_state_infinite(
    held_ones: dict[str, dict[str, Driven]], wild: list[float], name: str, precision: str
) -> None:
    held = held_ones[precision][name]
    held.init()
    signal, codes = held.run(np.concatenate([np.array(wild), np.clip(wandering(4000), -55, 55)]))
    assert np.isfinite(signal).all()
    left_out = np.isin(codes[: len(wild)], [Verdict.MISSING, Verdict.NONFINITE, Verdict.OVERRANGE, Verdict.CLIPPED])
    assert left_out[~np.isfinite(np.array(wild))].all()
    assert (codes[-1000:] == Verdict.USED).all()


@pytest.mark.parametrize("precision", PRECISIONS)
def test_after_broken_readings_the_signal_is_back_within_the_settling_time(
    held_ones: dict[str, dict[str, Driven]], precision: str
) -> None:
    for held in held_ones[precision].values():
        settling = held.one.design.settled_rows
        readings = np.clip(wandering(3000 + settling), -55, 55)
        held.init()
        whole, _ = held.run(readings)
        for broken in (np.nan, np.inf, -np.inf):
            readings[1000:1500] = broken
            held.init()
            signal, codes = held.run(readings)
            assert (codes[1000:1500] != Verdict.USED).all()
            assert np.isfinite(signal).all()
            back = np.abs(signal - whole)[1500 + settling :]
            assert back.size > 1000
            assert back.max() <= 1e-4 * held.one.design.noise_std


@pytest.mark.parametrize(
    ("order", "cutoff", "far", "rows"),
    [(1, 1e-2, 1e4, 20_000), (1, 1e-3, 1e4, 60_000), (2, 1e-3, 3e3, 99_000), (3, 1e-3, 1e4, 99_000)],
)
def test_a_level_that_stays_stalls_as_foretold(
    order: int, cutoff: float, far: float, rows: int, tmp_path: Path
) -> None:
    """What `write_settled` avoids by a level that moves: far from its first reading a small gain moves nothing."""
    made = bundle(channel("level", order, cutoff))
    (one,) = made.channels
    stays = write_with_gains(
        one.design, schedule_in(one.design, FLOAT), one.prefix, FLOAT, WordLength(0, 0, 0, 1e9, None)
    )
    text = made.files["drive.c"].replace(one.written.source, stays.source)
    program = built(made._replace(files={**made.files, "drive.c": text}), tmp_path)
    signal, _ = through(program, one, np.concatenate([np.zeros(40), np.full(rows, far)]))
    found = float(np.abs(signal[-rows // 5 :] - far).max())
    assert 0.5 <= found / stall_of(one.design, FLOAT, far) <= 2.0
    moved, _ = through(built(made, tmp_path), one, np.concatenate([np.zeros(40), np.full(rows, far)]))
    assert one.written.word is not None
    assert one.written.word.stall <= 0.01 * one.design.settled_std
    assert float(np.abs(moved[-rows // 5 :] - far).max()) <= 2 * one.written.word.stall + np.spacing(np.float32(far))


def test_the_stall_that_is_known() -> None:
    """A gain of 1e-3 at 1e4: 0.49 units."""
    design = design_of(channel("level", 1, 1e-3), 0.01)
    assert design is not None
    assert stall_of(design, FLOAT, 1e4) == pytest.approx(0.49, rel=0.01)


def test_a_word_too_short_is_refused() -> None:
    design = design_of(channel("level", 1, 1e-6), 0.01)
    assert design is not None
    with pytest.raises(RecipeError, match="use --precision float64"):
        choose_word_length(design, FLOAT, 1e9)
    assert choose_word_length(design, DOUBLE, 1e6).share < 0.1


@pytest.mark.parametrize(("order", "cutoff"), [(1, 0.1), (1, 0.01), (2, 0.05), (3, 0.05)])
def test_what_rounding_adds_is_foretold(order: int, cutoff: float, tmp_path: Path) -> None:
    told = channel("ax", order, cutoff)
    made = bundle(told)
    (one,) = made.channels
    readings = wandering(60_000)
    signal, _ = through(built(made, tmp_path), one, readings)
    start = 3 * one.written.start_rows + 2000
    off = (signal - live(one, told, readings))[start:]
    assert one.written.word is not None
    last_digit = float(np.abs(signal).max()) * 2.0**-24 / np.sqrt(3)
    foretold = float(np.hypot(one.written.word.noise, last_digit))
    assert foretold / 4 <= off.std() <= 2 * foretold


def test_a_slow_table_is_thinned_and_stays_near(tmp_path: Path) -> None:
    told = channel("slow", 2, 2e-3)
    made = bundle(told)
    (one,) = made.channels
    assert not one.written.exact
    assert one.written.table_bytes <= 8192
    readings = np.random.default_rng(3).normal(5.0, 1.0, 40_000)
    signal, _ = through(built(made, tmp_path), one, readings)
    off = np.abs(signal - live(one, told, readings))
    assert off[:2].max() <= 1e-5
    spread = 2 / np.sqrt(1 + np.arange(len(off)))  # of a slope's estimate, until it has settled
    assert (off <= 0.1 * np.maximum(spread, one.design.settled_std)).all()
    assert off[3 * one.written.start_rows :].max() <= 1e-3 * one.design.settled_std


def test_thinned_gains_are_those_of_their_rows() -> None:
    design = design_of(channel("slow", 3, 5e-3), 0.01)
    assert design is not None
    whole, thinned = schedule_of(design, 1e-9, 60_000), schedule_of(design, 1e-9, 300)
    assert whole.exact
    assert not thinned.exact
    own = np.repeat(thinned.K, thinned.counts, axis=0)
    rows = min(len(own), len(whole.K))
    np.testing.assert_allclose(own[:rows], whole.K[:rows], rtol=0.05)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_another_rate_does_not_compile(precision: str, tmp_path: Path) -> None:
    made = bundle(CHANNELS["slope"], precision=precision)
    built(made, tmp_path, flags=("-DDRIVE_RUNS_AT_UHZ=100000000",))
    with pytest.raises(CompileError, match="export them again for the rate you run at"):
        built(made, tmp_path, flags=("-DDRIVE_RUNS_AT_UHZ=200000000",))


def test_a_two_state_filter_is_small() -> None:
    (one,) = bundle(CHANNELS["slope"]).channels
    assert one.written.state_bytes == 16
    assert one.written.cost is not None
    assert (one.written.cost.multiplications, one.written.cost.divisions) == (3, 0)


def test_the_reference_starts_anew_where_a_first_reading_is_missing() -> None:
    design = design_of(CHANNELS["slope"], 0.01)
    assert design is not None
    reference = SettledReference(design, schedule_of(design, 1e-9), design.largest)
    _, codes = reference.run(np.array([1.0, np.nan, 2.0, 3.0]))
    assert codes.tolist() == [STARTING, Verdict.MISSING, STARTING, Verdict.USED]


def test_a_digit_is_as_ieee_has_it() -> None:
    assert ulp(FLOAT, 1e4) == float(np.spacing(np.float32(1e4)))
    assert ulp(DOUBLE, 1e4) == float(np.spacing(1e4))
