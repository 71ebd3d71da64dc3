"""A switching bank in C: the numbers of becalm's own stream, in double to its last digits, in float to 120 dB."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from banked import KINDS, NAMES, RATE_HZ, bundle_of_bank, expected, nervous, one_noise, record, spoilt, told_of
from becalm.cleaning.tuning import tune
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.core.verdict import Verdict
from becalm.errors import RecipeError
from becalm.export.bank.cost import row_cost
from becalm.export.bank.text import reach_of_bank
from becalm.export.number_type import DOUBLE, FLOAT
from becalm.export.proof.compiling import OPTIMISED, SANITIZED, compilers, run
from driven import UNDEFINED, Driven, driven_one
from exported import built, bundle, through

PRECISIONS = ("float64", "float32")
Banks = Callable[[str, str], Driven]


@pytest.fixture(scope="module")
def banks(tmp_path_factory: pytest.TempPathFactory) -> Banks:
    """Return what compiles a bank by its name, once, and gives it as `_init` leaves it."""
    folder, made = tmp_path_factory.mktemp("banks"), dict[tuple[str, str], Driven]()

    def bank(name: str, precision: str) -> Driven:
        if (name, precision) not in made:
            made[name, precision] = driven_one(bundle_of_bank(name, precision), folder)
        made[name, precision].init()
        return made[name, precision]

    return bank


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize("made_of", [record, spoilt])
def test_double_tells_the_numbers_of_becalm(kind: str, order: int, made_of: object) -> None:
    one, z = program(f"{kind} {order}", DOUBLE), record(3000, 5) if made_of is record else spoilt(3000, 7)
    told, want = one.run(z), one.expected(z)
    largest = np.abs(want.signal).max()
    assert np.abs(told.signal - want.signal).max() <= 1e-12 * largest
    np.testing.assert_array_equal(told.codes, want.codes)
    np.testing.assert_allclose(told.modes, want.modes, rtol=0, atol=1e-9)
    if kind in ("spiky", "jumping") and made_of is spoilt:
        assert (told.codes == Verdict.SPIKE).sum() > (5 if kind == "spiky" else -1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize("level", [0.0, 1e5])
def test_float_keeps_120_decibels(kind: str, order: int, level: float) -> None:
    one = program(f"{kind} {order}", FLOAT)
    z = one.as_given(spoilt(3000, 7) + level)
    told, want = one.run(z), one.expected(z)
    signal, off = want.signal - level * (want.signal != 0), told.signal - want.signal
    np.testing.assert_array_equal(told.codes, want.codes)
    assert np.sum(off**2) <= 1e-12 * np.sum(want.signal**2)
    if level:  # and its own last digit is all that is lost beside a large level
        assert np.sqrt(np.mean(off**2)) < np.spacing(np.float32(level))
        assert np.abs(signal).max() < 1e3
    np.testing.assert_allclose(told.modes, want.modes, rtol=0, atol=1e-2)


@pytest.mark.parametrize("number", NUMBERS)
def test_limits_are_kept_and_the_state_is_as_large_as_said(number: NumberType) -> None:
    one, z = program("limited", number), spoilt(1000, 3)
    z[100:110], z[200], z[300] = z[100], 300.0, -1e4
    z = one.as_given(z)
    told, want = one.run(z), one.expected(z)
    np.testing.assert_array_equal(told.codes, want.codes)
    assert {Verdict.STUCK, Verdict.CLIPPED, Verdict.SPIKE} <= set(told.codes.tolist())
    for name in ("limited", "nervous", "jumping 1", "resting 3"):
        assert program(name, number).size() == program(name, number).written.state_bytes


@pytest.mark.parametrize("number", NUMBERS)
def test_a_gap_is_as_many_missing_readings(number: NumberType) -> None:
    one, z = program("spiky 3", number), one_noise(400)
    for rows in (1, 7, 500):
        at_once = one.run(z[200:], *(f"z {value.hex()}" for value in z[:200].tolist()), f"g {rows}")
        each = one.run(np.concatenate([z[:200], np.full(rows, np.nan), z[200:]]))
        np.testing.assert_array_equal(at_once.signal[200:], each.signal[200 + rows :])


@pytest.mark.parametrize("read", [1, 2, 3, 5, 200])
def test_it_begins_anew_where_becalm_does(read: int) -> None:
    """After a gap beyond reach: of the slowest growth, and of what a few first readings told."""
    one, z = program("nervous", DOUBLE), one_noise(read + 6)
    assert one.design.modes is not None
    reach = reach_of_bank(one.design.modes)
    for missed in (int(reach.longest) - 1, int(reach.longest), int(reach.spans) * (read - 1) + 300):
        rows = np.concatenate([z[:read], np.full(missed, np.nan), z[read:]])
        told, want = one.run(rows), one.expected(rows)
        anew = missed + 1 > min(reach.longest, reach.spans * (read - 1) if read >= reach.readings else np.inf)
        assert (want.signal[-6] == z[-6]) == anew
        np.testing.assert_allclose(told.signal[-6:], want.signal[-6:], rtol=0, atol=1e-13 if anew else 1e-8)
        if anew:
            np.testing.assert_array_equal(told.modes[-6:], one.run(z[-6:]).modes)


def test_reset_begins_as_with_a_reading() -> None:
    one, z = program("resting 3", DOUBLE), record(500, 4)
    known = one.run(z, "r 12.5")
    read = one.run(np.concatenate([[12.5], z]))
    np.testing.assert_array_equal(known.signal, read.signal[1:])
    np.testing.assert_array_equal(one.run(z, "r nan").signal, one.run(z).signal)


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("flags", OPTIMISED, ids="".join)
def test_exp_and_root_are_right_to_two_last_digits(number: NumberType, flags: tuple[str, ...]) -> None:
    one, rng = program("noisy 1", number, "cc", flags), np.random.default_rng(1)
    cut = 708.0 if number.is_double else 87.0
    y = np.concatenate([rng.uniform(0, cut, 4000), rng.uniform(0, 1, 1000), 10.0 ** rng.uniform(-30, 1, 1000)])
    y = y.astype(number.dtype).astype(np.float64)
    got = np.array(
        [[float.fromhex(word) for word in line.split()] for line in one.answers([f"e {v.hex()}" for v in y])]
    )
    exact = y.astype(np.longdouble)
    digit = 2.0 ** (1 - number.bits)
    assert np.max(np.abs(got[:, 0] / np.exp(-exact) - 1)) <= 2 * digit
    assert np.max(np.abs(got[:, 1] * np.sqrt(exact) - 1)) <= 2 * digit
    ends = [line.split()[0] for line in one.answers(["e 0", f"e {cut}", "e 1e30"])]
    assert [float.fromhex(end) for end in ends] == [1.0, 0.0, 0.0]


def test_what_a_row_costs_is_counted_by_its_loops() -> None:
    source = """static double b_one(double x)
{
    return x * x + 1.0;
}

static double b_all(double x)
{
    double sum = 0.0;
    for (uint32_t a = 0u; a < 3u; a++) {
        sum += b_one(x) / x;
        for (uint32_t b = 0u; b <= a; b++) {
            sum += x * x;
        }
        for (uint32_t b = 0u; b < a; b++) {
            sum -= x;
        }
    }
    return sum;
}
"""
    assert row_cost(source, ["b_all", "b_none"]) == (3 + 6, 3 + 3 + 6 + 3, 3)


@pytest.mark.parametrize("noise_std", [1e-25, 1e20])
def test_float_refuses_what_it_cannot_hold(noise_std: float) -> None:
    design = design_of(nervous(1, noise_std), 1 / RATE_HZ)
    assert design is not None
    with pytest.raises(RecipeError, match="float64"):
        Bank(FLOAT).write(design, "b", None)
    assert Bank(DOUBLE).write(design, "b", None).largest > 0


@pytest.mark.slow
@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("flags", [*OPTIMISED, SANITIZED], ids="".join)
@pytest.mark.parametrize("name", RECIPES)
def test_golden_vectors_pass_with_every_compiler(name: str, number: NumberType, flags: tuple[str, ...]) -> None:
    for compiler in compilers():
        one = program(name, number, compiler, flags)
        opened = partial(one.kind.reference, one.recipe, one.design, one.written)
        for vector in golden_vectors(one.design, one.as_given, opened, None):
            cuts = dict(zip(vector.gap_rows.tolist(), vector.gap_lengths.tolist(), strict=True))
            commands = []
            for row, value in enumerate(vector.readings.tolist()):
                commands += [f"g {cuts[row]}"] if row in cuts else []
                commands.append(f"z {value.hex()}")
            rows = [line.split() for line in one.answers(commands)]
            signal = np.array([float.fromhex(row[0]) for row in rows])
            assert np.abs(signal - vector.signal).max() <= one.kind.most_error(vector, one.written, opened), vector.name
            np.testing.assert_array_equal([int(row[1]) for row in rows], vector.codes)


@pytest.mark.slow
@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("name", RECIPES)
def test_nothing_that_is_read_makes_it_nan(name: str, number: NumberType) -> None:
    one, rng = program(name, number, "cc", SANITIZED), np.random.default_rng(2)
    z = rng.normal(size=20_000) * 10.0 ** rng.uniform(-45, 45, 20_000) * (rng.random(20_000) < 0.9)
    z[rng.random(20_000) < 0.1] = np.nan
    z[5000:9000] *= rng.random(4000) < 0.01
    z[9000:14000] = np.where(rng.random(5000) < 0.5, one.written.largest, -one.written.largest)
    told = one.run(one.as_given(z))
    assert np.isfinite(told.signal).all()
    assert (told.modes >= 0).all()
    assert (told.modes <= 1.001).all()


@pytest.mark.slow
@pytest.mark.parametrize("number", NUMBERS)
def test_a_tuned_recipe_is_followed(number: NumberType) -> None:
    truth = np.repeat(4 * np.random.default_rng(1).normal(size=10), 600)
    z = truth + np.random.default_rng(2).normal(size=6000)
    (channel,) = tune(Recording(z, names=["a"], units=["V"], rate_hz=RATE_HZ), causal=True).channel
    one = Program(channel.model_copy(update={"tuning_spread": 0.0}), number, "cc", ("-O2",))
    z = one.as_given(z)
    told, want = one.run(z), one.expected(z)
    off = told.signal - want.signal
    assert np.sum(off**2) <= (1e-24 if number.is_double else 1e-12) * np.sum(want.signal**2)
    np.testing.assert_array_equal(told.codes, want.codes)
