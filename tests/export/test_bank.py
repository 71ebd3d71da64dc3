"""A switching bank in C: the numbers of becalm's own stream, in double to its last digits, in float to 120 dB."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from banked import KINDS, NAMES, RATE_HZ, bundle_of_bank, expected, nervous, one_noise, record, spoilt, told_of
from becalm.cleaning.tuning import tune
from becalm.core.arrays import Floats
from becalm.core.recording import Recording
from becalm.core.verdict import Verdict
from becalm.errors import RecipeError
from becalm.export.bank.text import reach_of_bank
from becalm.export.bundle import Bundle
from becalm.export.number_type import DOUBLE, FLOAT, NumberType
from becalm.export.proof.compiling import OPTIMISED, SANITIZED, run
from driven import UNDEFINED, Driven, driven_one
from exported import EVERY_BUILD, built, bundle, through

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
def test_double_tells_the_numbers_of_becalm(
    banks: Banks, kind: str, order: int, made_of: Callable[[int, int], Floats]
) -> None:
    name = f"{kind} {order}"
    held, z = banks(name, "float64"), made_of(3000, 5 if made_of is record else 7)
    told, want = held.steps(z), expected(told_of(name), held.one, z)
    largest = np.abs(want.signal).max()
    assert np.abs(told.signal - want.signal).max() <= 1e-12 * largest
    np.testing.assert_array_equal(told.codes, want.codes)
    np.testing.assert_allclose(told.modes, want.modes, rtol=0, atol=1e-9)
    if kind == "spiky" and made_of is spoilt:
        assert (told.codes == Verdict.SPIKE).sum() > 5


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize("level", [0.0, 1e5])
def test_float_keeps_120_decibels(banks: Banks, kind: str, order: int, level: float) -> None:
    name = f"{kind} {order}"
    held = banks(name, "float32")
    z = held.rounded(spoilt(3000, 7) + level)
    told, want = held.steps(z), expected(told_of(name), held.one, z)
    signal, off = want.signal - level * (want.signal != 0), told.signal - want.signal
    np.testing.assert_array_equal(told.codes, want.codes)
    assert np.sum(off**2) <= 1e-12 * np.sum(want.signal**2)
    if level:  # and its own last digit is all that is lost beside a large level
        assert np.sqrt(np.mean(off**2)) < np.spacing(np.float32(level))
        assert np.abs(signal).max() < 1e3
    np.testing.assert_allclose(told.modes, want.modes, rtol=0, atol=1e-2)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_limits_are_kept(banks: Banks, precision: str) -> None:
    held, z = banks("limited", precision), spoilt(1000, 3)
    z[100:110], z[200], z[300] = z[100], 300.0, -1e4
    z = held.rounded(z)
    told, want = held.steps(z), expected(told_of("limited"), held.one, z)
    np.testing.assert_array_equal(told.codes, want.codes)
    assert {Verdict.STUCK, Verdict.CLIPPED, Verdict.SPIKE} <= set(told.codes.tolist())


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", ["limited", "nervous", "jumping 1", "resting 3"])
def test_the_state_is_as_large_as_said(banks: Banks, name: str, precision: str) -> None:
    held = banks(name, precision)
    assert held.size == held.one.written.state_bytes


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_gap_is_as_many_missing_readings(banks: Banks, precision: str) -> None:
    held, z = banks("spiky 3", precision), one_noise(400)
    for rows in (1, 7, 500):
        held.init()
        held.run(z[:200])
        held.gap(rows)
        at_once = held.run(z[200:])
        held.init()
        each = held.run(np.concatenate([z[:200], np.full(rows, np.nan), z[200:]]))
        np.testing.assert_array_equal(at_once[0], each[0][200 + rows :])
        np.testing.assert_array_equal(at_once[1], each[1][200 + rows :])


@pytest.mark.parametrize("read", [1, 2, 3, 5, 200])
def test_it_begins_anew_where_becalm_does(banks: Banks, read: int) -> None:
    """After a gap beyond reach: of the slowest growth, and of what a few first readings told."""
    held, z = banks("nervous", "float64"), one_noise(read + 6)
    assert held.one.design.modes is not None
    reach = reach_of_bank(held.one.design.modes)
    for missed in (int(reach.longest) - 1, int(reach.longest), int(reach.spans) * (read - 1) + 300):
        rows = np.concatenate([z[:read], np.full(missed, np.nan), z[read:]])
        held.init()
        told, want = held.steps(rows), expected(told_of("nervous"), held.one, rows)
        anew = missed + 1 > min(reach.longest, reach.spans * (read - 1) if read >= reach.readings else np.inf)
        assert (want.signal[-6] == z[-6]) == anew
        # anew: of three states the order of sums is worth 2e-11 in the first rows, on either side of the exact numbers
        np.testing.assert_allclose(told.signal[-6:], want.signal[-6:], rtol=0, atol=1e-10 if anew else 1e-8)
        if anew:
            held.init()
            np.testing.assert_array_equal(told.modes[-6:], held.steps(z[-6:]).modes)


def test_reset_begins_as_with_a_reading(banks: Banks) -> None:
    held, z = banks("resting 3", "float64"), record(500, 4)
    held.reset(12.5)
    known = held.steps(z)
    held.init()
    read = held.steps(np.concatenate([[12.5], z]))
    np.testing.assert_array_equal(known.signal, read.signal[1:])
    np.testing.assert_array_equal(known.modes, read.modes[1:])
    held.reset(np.nan)
    anew = held.steps(z)
    held.init()
    np.testing.assert_array_equal(anew.signal, held.steps(z).signal)


@pytest.mark.parametrize("number", [DOUBLE, FLOAT], ids=PRECISIONS)
@pytest.mark.parametrize("flags", OPTIMISED, ids="".join)
def test_exp_and_root_are_right_to_two_last_digits(number: NumberType, flags: tuple[str, ...], tmp_path: Path) -> None:
    made, real = bundle_of_bank("noisy 1", number.precision), number.name
    prefix = made.channels[0].prefix
    shown = "".join(
        f"{real} {prefix}_shown_{name}({real} y);\n"
        f"{real} {prefix}_shown_{name}({real} y) {{ return {prefix}_{name}(y); }}\n"
        for name in ("decay", "per_root")
    )
    held = driven_one(made, tmp_path, *flags, more=shown)
    decay, per_root = (held.called(f"shown_{name}") for name in ("decay", "per_root"))
    rng, cut = np.random.default_rng(1), 708.0 if number.is_double else 87.0
    y = np.concatenate([rng.uniform(0, cut, 4000), rng.uniform(0, 1, 1000), 10.0 ** rng.uniform(-30, 1, 1000)])
    y = y.astype(number.dtype).astype(np.float64)
    got = np.array([[decay(value), per_root(value)] for value in y.tolist()])
    exact = y.astype(np.longdouble)
    digit = 2.0 ** (1 - number.bits)
    assert np.max(np.abs(got[:, 0] / np.exp(-exact) - 1)) <= 2 * digit
    assert np.max(np.abs(got[:, 1] * np.sqrt(exact) - 1)) <= 2 * digit
    assert [decay(end) for end in (0.0, cut, 1e30)] == [1.0, 0.0, 0.0]


@pytest.mark.parametrize("noise_std", [1e-25, 1e20])
def test_float_refuses_what_it_cannot_hold(noise_std: float) -> None:
    with pytest.raises(RecipeError, match="float64"):
        bundle(nervous(1, noise_std), rate_hz=RATE_HZ)
    (one,) = bundle(nervous(1, noise_std), rate_hz=RATE_HZ, precision="float64").channels
    assert one.written.largest > 0


@pytest.mark.slow
@EVERY_BUILD
@pytest.mark.parametrize("precision", PRECISIONS)
def test_golden_vectors_pass_with_every_compiler(
    precision: str, compiler: str, flags: tuple[str, ...], tmp_path: Path
) -> None:
    ran = run(built(every_bank(precision), tmp_path, compiler, flags))
    assert (ran.returncode, ran.stdout.count("passed:")) == (0, 10 * len(NAMES)), ran.stdout + ran.stderr


@cache
def every_bank(precision: str) -> Bundle:
    named = [told_of(name).model_copy(update={"name": f"c{k}"}) for k, name in enumerate(NAMES)]
    return bundle(*named, rate_hz=RATE_HZ, precision=precision)


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", NAMES)
def test_nothing_that_is_read_makes_it_nan(name: str, precision: str, tmp_path: Path) -> None:
    made, rng = bundle_of_bank(name, precision), np.random.default_rng(2)
    (one,) = made.channels
    z = rng.normal(size=20_000) * 10.0 ** rng.uniform(-45, 45, 20_000) * (rng.random(20_000) < 0.9)
    z[rng.random(20_000) < 0.1] = np.nan
    z[5000:9000] *= rng.random(4000) < 0.01
    z[9000:14000] = np.where(rng.random(5000) < 0.5, one.written.largest, -one.written.largest)
    held = driven_one(made, tmp_path, *UNDEFINED)
    told, (signal, codes) = held.steps(z), through(built(made, tmp_path, flags=SANITIZED), one, z)
    assert np.isfinite(signal).all()
    np.testing.assert_array_equal(signal, told.signal)
    np.testing.assert_array_equal(codes, told.codes)
    assert (told.modes >= 0).all()
    assert (told.modes <= 1.001).all()


@pytest.mark.slow
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_tuned_recipe_is_followed(precision: str, tmp_path: Path) -> None:
    truth = np.repeat(4 * np.random.default_rng(1).normal(size=10), 600)
    z = truth + np.random.default_rng(2).normal(size=6000)
    (tuned,) = tune(Recording(z, names=["a"], units=["V"], rate_hz=RATE_HZ), causal=True).channel
    channel = tuned.model_copy(update={"tuning_spread": 0.0})
    held = driven_one(bundle(channel, rate_hz=RATE_HZ, precision=precision), tmp_path)
    z = held.rounded(z)
    told, want = held.steps(z), expected(channel, held.one, z)
    off = told.signal - want.signal
    assert np.sum(off**2) <= (1e-24 if precision == "float64" else 1e-12) * np.sum(want.signal**2)
    np.testing.assert_array_equal(told.codes, want.codes)
