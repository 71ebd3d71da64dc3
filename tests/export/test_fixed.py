"""A settled filter in fixed point: the same filter, proved to have digits enough, whatever counts come."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.cleaning.recipes.recipe_parts import LimitsRecipe
from becalm.core.reading_verdicts import Verdict
from becalm.errors import RecipeError
from becalm.export.bundle import Bundle
from becalm.export.fixed.text import GREATEST, count_limits_of, factor_of, scale_of, schedule_in
from becalm.export.fixed.word_length import fit
from becalm.export.number_type import DOUBLE
from becalm.export.proof.compiling import run
from becalm.export.settled.text import write_with_gains
from becalm.export.vectors import STARTING
from becalm.export.word_length import WordLength
from driven import UNDEFINED, Driven, driven, driven_one
from exported import BUILDS, HUM, SPAN, TONE, built, bundle, channel, fixed, live, need, snr_db, through, wandering

MISSING = -GREATEST - 1
CHANNELS = {
    "level": channel("level", 1, 0.2),
    "slow": channel("slow", 1, 1e-3),
    "slope": channel("slope", 2, 0.05),
    "bend": channel("bend", 3, 0.02),
    "snap": channel("snap", 5, 0.1),
    "lazy": channel("lazy", 5, 0.02),
    "returning": channel("returning", 2, 0.05, damped_below_hz=0.1),
    "tone": channel("tone", 2, 0.05, tone=(TONE,)),
    "hum": channel("hum", 1, 0.05, tone=(HUM,)),
    "railed": channel("railed", 2, 0.05, limits=LimitsRecipe(low=-60.0, high=90.0, stuck_readings=9)),
}


@pytest.fixture(scope="module")
def all_fixed() -> Bundle:
    """Write all channels."""
    return fixed(*CHANNELS.values())


def test_the_golden_vectors_pass(all_fixed: Bundle, tmp_path: Path) -> None:
    ran = run(built(all_fixed, tmp_path))
    assert ran.returncode == 0, ran.stdout
    assert ran.stdout.count("passed:") == 10 * len(CHANNELS)


@pytest.mark.slow
@pytest.mark.parametrize(("compiler", "flags"), BUILDS, ids=str)
def test_every_compiler_agrees(all_fixed: Bundle, compiler: str, flags: tuple[str, ...], tmp_path: Path) -> None:
    need(compiler)
    ran = run(built(all_fixed, tmp_path, compiler, flags))
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_a_wrong_number_fails_a_vector(tmp_path: Path) -> None:
    made = fixed(CHANNELS["slope"])
    design = made.channels[0].design
    point, _ = fit(design, schedule_in(design), 2 * SPAN / 2.0**32)
    gain = float(schedule_in(design).settled @ design.output) * 2.0 ** (point.signal - point.innovation)
    right, wrong = f", {factor_of(gain)[0]} }}", f", {factor_of(gain * 1.0001)[0]} }}"
    assert right in made.files["drive.c"]
    ran = run(
        built(made._replace(files={**made.files, "drive.c": made.files["drive.c"].replace(right, wrong)}), tmp_path)
    )
    assert ran.returncode == 1
    assert "FAILED" in ran.stdout


@pytest.mark.parametrize("name", ["level", "slope", "bend", "snap"])
def test_a_long_record_agrees_with_the_stream(name: str, tmp_path: Path) -> None:
    told = CHANNELS[name]
    made = fixed(told)
    (one,) = made.channels
    readings = 100 * wandering(100_000)
    signal, codes = through(built(made, tmp_path), one, readings)
    known = codes != STARTING
    known[: 0 if one.written.exact else 3 * one.written.start_rows + 2000] = False
    assert known.sum() > 95_000
    assert snr_db(signal[known], live(one, told, readings)[known]) >= 150


@cache
def in_plain_double() -> Bundle:
    return bundle(channel(), precision="float64")


def in_double(made: Bundle) -> Bundle:
    """Write the one filter of a bundle in float64, with the gains that it has in fixed point."""
    (one,) = made.channels
    schedule, word = schedule_in(one.design), WordLength(0, 0, 0, 1e300, None)
    written = write_with_gains(one.design, schedule, one.prefix, DOUBLE, word)
    plain = in_plain_double()
    (double,) = plain.channels
    source = plain.files["drive.c"].replace(double.written.source, written.source)
    header = plain.files["drive.h"].replace(double.written.header, written.header)
    files = {**plain.files, "drive.c": source, "drive.h": header}
    return plain._replace(files=files, channels=[double._replace(written=written)])


@pytest.mark.slow
@pytest.mark.parametrize("decade", range(4))
@pytest.mark.parametrize("order", range(1, 6))
def test_long_records_agree_with_float64(order: int, decade: int, tmp_path: Path) -> None:
    """q / R over twelve decades; a million readings where it settles late.

    A noise of one code of a converter of 16 bits, or of four of one of 24; with a tone and without: each order and each
    decade meets both.
    """
    cutoff = 10 ** (-4 * decade / (2 * order))
    tones, span = ((), (TONE,))[(order + decade) % 2], (2.0**15, 2.0**21)[(order + decade // 2) % 2]
    made = fixed(channel("ax", order, cutoff, tone=tones), span=(-span, span))
    double, held = driven_one(in_double(made), tmp_path), driven_one(made, tmp_path)
    k = np.arange(1_000_000 if cutoff <= 1e-3 else 100_000)
    readings = 0.3 * span * np.sin(k * min(cutoff, 0.05) / 30) + np.random.default_rng(1).normal(0, 1, len(k))
    want, codes = double.run(held.rounded(readings))
    signal, became = held.run(readings)
    np.testing.assert_array_equal(became, codes)
    known = codes != STARTING
    off = (signal - want)[known] / held.one.written.scale[1]  # type: ignore[index]
    assert np.abs(off).max() <= 2.0
    assert off.std() <= 0.35  # of a count: it is rounded to one, sqrt(1 / 12)
    assert snr_db(signal[known], want[known]) >= 120


def test_a_slow_filter_of_a_wide_range_is_refused() -> None:
    with pytest.raises(RecipeError, match="give a narrower --range"):
        fixed(channel("ax", 1, 1e-6), span=(-(2.0**21), 2.0**21))


WILD = st.one_of(
    st.integers(MISSING, GREATEST), st.sampled_from([MISSING, MISSING + 1, GREATEST, GREATEST - 1, 0, -GREATEST + 1])
)


@pytest.fixture(scope="module")
def held_ones(all_fixed: Bundle, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Driven]:
    return driven(all_fixed, tmp_path_factory.mktemp("held"), *UNDEFINED)


@settings(deadline=None, max_examples=60)
@given(st.sampled_from(sorted(CHANNELS)), st.lists(WILD, min_size=1, max_size=300), st.integers(1, 60))
def test_whatever_comes_it_does_as_specified(
    held_ones: dict[str, Driven], name: str, wild: list[int], hold: int
) -> None:
    """Undefined behaviour aborts; what was learned from full-scale readings, one way or the other, is the same."""
    held = held_ones[name]
    calm = np.random.default_rng(1).normal(0, 2.0**16, 3000) + 2.0**18 * np.sin(np.arange(3000) / 70)
    counts = np.concatenate([np.repeat(wild, hold)[:600], calm]).astype(np.int32)
    held.init()
    told, codes = held.block(counts)
    one = held.one
    signal, became = one.kind.reference(CHANNELS[name], one.design, one.written).run(
        one.kind.in_unit(counts, one.written)
    )
    assert told.min() > MISSING
    np.testing.assert_array_equal(codes, became)
    off = np.abs(told.astype(np.float64) - one.kind.counts(signal, one.written))
    assert off.max() <= 2.0**-18 * GREATEST  # of the full scale, while that is extrapolated
    assert off[-500:].max() <= 2


@pytest.mark.parametrize("name", ["level", "slope", "snap", "lazy", "tone"])
def test_it_recovers_from_full_scale(held_ones: dict[str, Driven], name: str) -> None:
    held, k = held_ones[name], np.arange(4000)
    full = GREATEST - 1
    far = {
        "square": np.where(k // 37 % 2, full, -full),
        "alternating": np.where(k % 2, full, -full),
        "missing": np.full(4000, MISSING),
        "holed": np.where(k // 50 % 2, MISSING, np.random.default_rng(1).choice([-full, full], 4000)),
        "saturated": np.full(4000, GREATEST),
    }
    calm = np.random.default_rng(2).normal(0, 2.0**16, 6000)
    for readings in far.values():
        held.init()
        told, codes = held.block(np.concatenate([readings, calm]))
        assert (codes[-1000:] == Verdict.USED).all()
        assert np.abs(told[-1000:]).max() <= 2.0**19


def test_gaps_are_missing_rows(held_ones: dict[str, Driven]) -> None:
    for held in held_ones.values():
        counts = (2.0**16 * np.clip(wandering(600), -59, 59)).astype(np.int32)
        told = []
        for gap in (True, False):
            held.init()
            held.block(counts[:300])
            held.gap(17) if gap else held.block(np.full(17, MISSING))
            told.append(held.block(counts[300:])[0])
        assert (told[0] == told[1]).all()


def test_a_reset_holds_its_signal(held_ones: dict[str, Driven]) -> None:
    for held in held_ones.values():
        held.reset(1_000_000)
        told, codes = held.block([MISSING, 1_000_000, 1_000_000])
        assert (told == 1_000_000).all()
        assert codes.tolist() == [Verdict.MISSING, Verdict.USED, Verdict.USED]


def test_rails_are_those_of_the_readings_in_unit() -> None:
    (one,) = fixed(CHANNELS["railed"]).channels
    limits = CHANNELS["railed"].limits
    assert limits is not None
    (wide,) = bundle(CHANNELS["railed"], precision="q31", spans={"railed": (-100.0, 333.0)}).channels
    assert wide.written.scale is not None
    scale = scale_of(-100.0, 333.0)
    rails = count_limits_of(wide.design, scale)
    assert scale.in_unit(rails.low) <= -60.0 < scale.in_unit(rails.low + 1)
    assert scale.in_unit(rails.high - 1) < 90.0 <= scale.in_unit(rails.high)
    assert count_limits_of(one.design, scale_of(-60.0, 90.0))[:2] == (-GREATEST, GREATEST)


def test_what_is_possible_is_kept_to(tmp_path: Path) -> None:
    told = channel("ax", limits=LimitsRecipe(largest=50.0))
    made = fixed(told, span=(-100.0, 100.0))
    (one,) = made.channels
    readings = np.array([1.0, 2.0, 3.0, 50.1, -50.1, 49.9, np.inf, np.nan])
    _, codes = through(built(made, tmp_path), one, readings)
    over = Verdict.OVERRANGE
    assert codes.tolist() == [STARTING, 0, 0, over, over, 0, over, Verdict.MISSING]
    assert "OVERRANGE" not in fixed(CHANNELS["slope"]).files["drive.c"]


def test_counts_are_readings_and_back() -> None:
    (one,) = fixed(CHANNELS["slope"], span=(-3.0, 5000.0)).channels
    readings = np.array([np.nan, np.inf, -np.inf, 1e305, -1e305, 0.0, 17.25])
    raw = one.kind.raw(readings, one.written)
    assert raw[:5].tolist() == [MISSING, GREATEST, -GREATEST, GREATEST, -GREATEST]
    back = one.kind.in_unit(raw, one.written)
    assert np.isnan(back[0])
    assert back[5] == 0.0
    assert back[6] == pytest.approx(17.25, abs=one.written.scale[1])  # type: ignore[index]


def test_a_settled_row_costs_what_is_said() -> None:
    (one,) = fixed(CHANNELS["level"]).channels
    assert one.written.cost is not None
    assert one.written.cost.multiplications == 4  # C K nu and F K nu, each in two
    assert one.written.cost.divisions == 0
    assert " / " not in one.written.source.split("becalm_status drive_level_step(")[1]
