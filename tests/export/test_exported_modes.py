"""Modes that switch in C: the bits and the decisions of becalm's own stream."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from banked import KINDS, NAMES, RATE_HZ, bundle_of_banks, expected, nervous, one_noise, record, spoilt, told_of
from becalm.cleaning.channels.filters import Filter
from becalm.cleaning.tuning import tune
from becalm.core.arrays import Floats
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording
from becalm.errors import RecipeError
from becalm.export.proof.compiling import run
from driven import Driven, Told, driven, driven_one
from exported import SANITIZED_O0, built, bundle, through

PRECISIONS = ("float64", "float32")
Banks = Callable[[str, str], Driven]


@pytest.fixture(scope="module")
def banks(tmp_path_factory: pytest.TempPathFactory) -> Banks:
    """Return what gives a bank by its name as `_init` leaves it; all are compiled once in each precision."""
    folder = tmp_path_factory.mktemp("banks")

    @cache
    def compiled(precision: str) -> list[Driven]:
        return list(driven(bundle_of_banks(precision), folder, "-O1").values())

    def bank(name: str, precision: str) -> Driven:
        held = compiled(precision)[NAMES.index(name)]
        held.init()
        return held

    return bank


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize("made_of", [record, spoilt])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_it_tells_the_numbers_of_becalm(
    banks: Banks, kind: str, order: int, made_of: Callable[[int, int], Floats], precision: str
) -> None:
    name = f"{kind} {order}"
    held = banks(name, precision)
    z = held.rounded(made_of(3000, 5 if made_of is record else 7))
    told, want = held.steps(z), expected(told_of(name), held.one, z)
    check_same(precision, told, want)
    if kind == "spiky" and made_of is spoilt:
        assert (told.codes == Verdict.SPIKE).sum() > 5


def check_same(precision: str, told: Told, want: Told) -> None:
    """Check that these are the same bits, but for what a float is rounded to."""
    number = np.float64 if precision == "float64" else np.float32
    np.testing.assert_array_equal(told.signal, want.signal.astype(number))
    np.testing.assert_array_equal(told.codes, want.codes)
    np.testing.assert_array_equal(told.modes, want.modes.astype(number))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_limits_are_kept(banks: Banks, precision: str) -> None:
    held, z = banks("limited", precision), spoilt(1000, 3)
    z[100:110], z[200], z[300] = z[100], 300.0, -1e4
    z = held.rounded(z)
    told, want = held.steps(z), expected(told_of("limited"), held.one, z)
    check_same(precision, told, want)
    assert {Verdict.STUCK, Verdict.CLIPPED, Verdict.SPIKE} <= set(told.codes.tolist())


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_state_is_as_large_as_said(banks: Banks, precision: str) -> None:
    for name in NAMES:
        held = banks(name, precision)
        assert held.size == held.one.written.state_bytes


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_gap_is_as_many_missing_readings(banks: Banks, precision: str) -> None:
    held, z = banks("spiky 3", precision), one_noise(400)
    for rows in (1, 7, 500, 1000):
        held.init()
        held.run(z[:200])
        held.gap(rows)
        at_once = held.run(z[200:])
        held.init()
        each = held.run(np.concatenate([z[:200], np.full(rows, np.nan), z[200:]]))
        np.testing.assert_array_equal(at_once[0], each[0][200 + rows :])
        np.testing.assert_array_equal(at_once[1], each[1][200 + rows :])


def test_a_long_gap_leaves_modes_as_probable_as_in_the_long_run(banks: Banks) -> None:
    held, z = banks("noisy 3", "float64"), one_noise(400)
    held.run(z)
    held.gap(40_000)
    at_once = held.steps(np.full(1, np.nan))
    held.init()
    held.run(z)
    for _ in range(40):
        held.gap(1000)
    each = held.steps(np.full(1, np.nan))
    np.testing.assert_allclose(at_once.modes, each.modes, atol=1e-9)
    np.testing.assert_allclose(at_once.signal, each.signal, rtol=1e-6)


@pytest.mark.parametrize("read", [1, 2, 3, 5, 200])
def test_it_begins_anew_where_becalm_does(banks: Banks, read: int) -> None:
    """After a gap beyond reach: of the slowest growth, and of what a few first readings told."""
    held, z = banks("nervous", "float64"), one_noise(read + 6)
    assert held.one.design.modes is not None
    limit = Filter(told_of("nervous"), 1 / RATE_HZ, 0).gap_limit
    for missed in (int(limit.longest) - 1, int(limit.longest), int(limit.spans) * (read - 1) + 300):
        rows = np.concatenate([z[:read], np.full(missed, np.nan), z[read:]])
        held.init()
        told, want = held.steps(rows), expected(told_of("nervous"), held.one, rows)
        anew = missed + 1 > min(limit.longest, limit.spans * (read - 1) if read >= limit.readings else np.inf)
        assert (want.signal[-6] == z[-6]) == anew
        check_same("float64", told, want)
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


@pytest.mark.parametrize("noise_std", [1e-35, 1e20])
def test_float_refuses_what_it_cannot_hold(noise_std: float) -> None:
    with pytest.raises(RecipeError, match="float64"):
        bundle(nervous(1, noise_std), rate_hz=RATE_HZ)
    (one,) = bundle(nervous(1, noise_std), rate_hz=RATE_HZ, precision="float64").channels
    assert one.written.largest > 0


HALF = ("resting 1", "jumping 3", "noisy 1", "spiky 3", "bursting 1", "limited", "damped 3")
OTHERS = tuple(name for name in NAMES if name not in HALF)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("compiler", "flag", "precision", "names"),
    [("gcc", "-O3", "float32", HALF), ("clang", "-O2", "float64", OTHERS)],
)
def test_golden_vectors_pass_with_every_compiler(
    compiler: str, flag: str, precision: str, names: tuple[str, ...], tmp_path: Path
) -> None:
    ran = run(built(bundle_of_banks(precision, *names), tmp_path, compiler, (flag,)))
    assert (ran.returncode, ran.stdout.count("passed:")) == (0, 10 * len(names)), ran.stdout + ran.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("compiler", "precision"), [("gcc", "float32"), ("clang", "float64")])
def test_nothing_that_is_read_makes_it_nan(compiler: str, precision: str, banks: Banks, tmp_path: Path) -> None:
    """Under sanitizers, and to the same bits as optimised; golden vectors too."""
    made, rng = bundle_of_banks(precision), np.random.default_rng(2)
    program = built(made, tmp_path, compiler, SANITIZED_O0)
    ran = run(program)
    assert (ran.returncode, ran.stdout.count("passed:")) == (0, 10 * len(NAMES)), ran.stdout + ran.stderr
    for name, one in zip(NAMES, made.channels, strict=True):
        z = rng.normal(size=8000) * 10.0 ** rng.uniform(-45, 45, 8000) * (rng.random(8000) < 0.9)
        z[rng.random(8000) < 0.1] = np.nan
        z[2000:4000] *= rng.random(2000) < 0.01
        z[4000:6000] = np.where(rng.random(2000) < 0.5, one.written.largest, -one.written.largest)
        told, (signal, codes) = banks(name, precision).steps(z), through(program, one, z)
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
    held = driven_one(bundle(tuned, rate_hz=RATE_HZ, precision=precision), tmp_path)
    z = held.rounded(z)
    told, want = held.steps(z), expected(tuned, held.one, z)
    check_same(precision, told, want)
