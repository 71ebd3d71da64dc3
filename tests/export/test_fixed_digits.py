"""Digits of a filter in fixed point: its arithmetic, and what is proved of it before anything runs."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from becalm.cleaning.recipes.recipe import ChannelRecipe
from becalm.errors import RecipeError
from becalm.export.fixed.kind import FixedReference
from becalm.export.fixed.text import GREATEST, factor_of, scale_of, schedule_in
from becalm.export.fixed.word_length import bound_states, fit, noise_of, stall_of
from driven import UNDEFINED, Driven, driven_one, library
from exported import SPAN, bundle, channel, fixed


def level(held: Driven, digits: int) -> float:
    """Return the first state of a filter in fixed point, in counts."""
    return int(np.frombuffer(held.state[:8], np.int64)[0]) / 2.0**digits


@pytest.mark.parametrize(
    ("order", "cutoff", "most"), [(1, 1e-2, 1.1), (1, 1e-3, 1.1), (1, 1e-4, 1.1), (2, 1e-3, 1.0), (3, 3e-3, 1.0)]
)
def test_it_stalls_as_foretold(order: int, cutoff: float, most: float, tmp_path: Path) -> None:
    """After steps of many sizes; a level alone always ends where it stalls, a slope beside it at most there."""
    made = fixed(channel("ax", order, cutoff), span=(-(2.0**13), 2.0**13))
    held = driven_one(made, tmp_path)
    design = held.one.design
    point, _ = fit(design, schedule_in(design), 2.0**-18)
    rows, found = int(60 / float(design.steady.gain[0, 0]) + 50 / cutoff), []  # type: ignore[union-attr]
    for target in np.geomspace(1e3, 1e8, 12 if order > 1 else 3).astype(int):
        held.reset(0)
        held.block(np.full(rows, target))
        found.append(abs(level(held, point.states[0]) - target))
    assert max(found) <= most * stall_of(design, point)
    assert max(found) >= 0.5 * stall_of(design, point)


@pytest.mark.parametrize(("order", "cutoff"), [(3, 0.003), (4, 0.02), (5, 0.05)])
def test_rounding_is_as_foretold(order: int, cutoff: float, tmp_path: Path) -> None:
    told = channel("ax", order, cutoff)
    held = driven_one(fixed(told), tmp_path)
    one, design = held.one, held.one.design
    point, _ = fit(design, schedule_in(design), 2 * SPAN / 2.0**32)
    counts = np.random.default_rng(2).normal(0, 2.0**14, 20_000).astype(np.int32)
    reference = one.kind.reference(told, design, one.written)
    assert isinstance(reference, FixedReference)
    off = []
    for piece in np.split(counts, 2000):
        held.block(piece)
        reference.run(one.kind.in_unit(piece, one.written))
        off.append(level(held, point.states[0]) - (reference.level + reference.p[0]) * 2.0**32 / (2 * SPAN))
    assert design.steady is not None
    foretold = noise_of(design.steady, point)
    assert foretold / 4 <= np.std(off[-1500:]) <= 2 * foretold


def test_readings_a_count_higher_make_a_signal_a_count_higher(tmp_path: Path) -> None:
    """In whole numbers exactly, so that no level is better than another."""
    held = driven_one(fixed(channel("ax", 3, 0.02)), tmp_path)
    counts, signals = np.random.default_rng(2).normal(0, 2.0**20, 3000).astype(np.int32), []
    for higher in (0, 2_000_000_001):
        held.init()
        signals.append(held.block(counts + higher)[0] - higher)
    assert (signals[0] == signals[1]).all()


HELPERS = [
    ("int64_t", "times", ("int64_t v", "int32_t m", "uint32_t shift")),
    ("int64_t", "rounded", ("int64_t v", "uint32_t shift")),
    ("int64_t", "sum", ("int64_t a", "int64_t b")),
    ("int32_t", "output", ("int64_t v", "uint32_t shift")),
    ("bool", "is_beyond", ("int64_t v",)),
]
MOST = (1 << 62) - 1
STATE = st.one_of(st.integers(-MOST, MOST), st.sampled_from([-MOST, MOST, 0, -1, 1, 1 << 31, -(1 << 31)]))
MANTISSA = st.one_of(st.integers(1 << 30, GREATEST), st.integers(-GREATEST, -(1 << 30)), st.just(0))


@pytest.fixture(scope="module")
def arithmetic(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    text = ""
    for kind, name, words in HELPERS:
        taken, given_on = ", ".join(words), ", ".join(word.split()[1] for word in words)
        text += f"{kind} {name}({taken}); {kind} {name}({taken}) {{ return becalm_{name}({given_on}); }}\n"
    found = library(fixed(channel()), tmp_path_factory.mktemp("arithmetic"), *UNDEFINED, more=text)
    for name in ("times", "rounded", "sum"):
        getattr(found, name).restype = ctypes.c_int64
    found.is_beyond.restype = ctypes.c_bool
    return found


@settings(deadline=None, max_examples=500)
@given(STATE, STATE, MANTISSA, st.integers(1, 92))
def test_the_arithmetic_is_that_of_whole_numbers(arithmetic: ctypes.CDLL, v: int, w: int, m: int, shift: int) -> None:
    def kept(exact: int, most: int = MOST) -> int:
        return max(-most, min(most, exact))

    v64, w64 = ctypes.c_int64(v), ctypes.c_int64(w)
    exact = (v * m + (1 << (shift - 1))) >> shift
    got = arithmetic.times(v64, m, ctypes.c_uint32(shift))
    ends = abs(exact) > MOST - (1 << max(62 - shift, 31))  # there a factor above 1 may be at its end already
    assert got == kept(exact) or (ends and abs(got) > MOST // 2 and (got > 0) == (exact > 0))
    assert arithmetic.sum(v64, w64) == kept(v + w)
    narrow = min(shift, 62)
    rounded = (v + (1 << (narrow - 1))) >> narrow
    assert arithmetic.rounded(v64, ctypes.c_uint32(narrow)) == rounded
    assert arithmetic.output(v64, ctypes.c_uint32(narrow)) == kept(rounded, GREATEST)
    assert arithmetic.is_beyond(v64) == (abs(v) > MOST // 2)


@given(st.floats(1e-18, 1e9), st.booleans())
def test_a_factor_has_31_bits(size: float, negative: bool) -> None:
    value = -size if negative else size
    mantissa, shift = factor_of(value)
    assert 1 << 30 <= abs(mantissa) <= GREATEST
    assert mantissa / 2.0**shift == pytest.approx(value, rel=2.0**-31)


@given(st.floats(-1e7, 1e7), st.floats(1e-2, 1e6))
def test_a_count_stands_for_0_where_0_is_in_reach(low: float, width: float) -> None:
    scale = scale_of(low, low + width)
    digit = 2 * np.spacing(abs(low) + width)
    zero = round(float(scale.counts(np.zeros(1))[0]))
    assert abs(zero) == GREATEST or scale.in_unit(zero) == 0.0
    assert abs(scale.in_unit(GREATEST) - (low + width)) <= 2 * scale.lsb + digit
    assert abs(scale.in_unit(-GREATEST) - low) <= 2 * scale.lsb + digit


REFUSED = {
    "unknown": (channel("ax"), None, r"give --range LOW:HIGH in m/s\^2, or low and high in \[channel.limits\]"),
    "crossed": (channel("ax"), (5.0, 5.0), "a range is LOW:HIGH"),
    "far": (channel("ax"), (1e12, 1e12 + 1), "too narrow at that distance from 0"),
    "loud": (channel("ax"), (-1e10, 1e10), "more than their noise of 1 m/s.2; give a narrower --range"),
    "slow": (channel("ax", 1, 1e-5), (-1e7, 1e7), "at most a tenth is allowed.*give a narrower --range"),
    "endless": (channel("ax", 5, 1e-3), (-SPAN, SPAN), "its states are .*--precision float64"),
}


@pytest.mark.parametrize(("told", "span", "said"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_proved_is_refused(told: ChannelRecipe, span: tuple[float, float] | None, said: str) -> None:
    with pytest.raises(RecipeError, match=said):
        bundle(told, precision="q31", spans={} if span is None else {"ax": span})


def test_states_reach_as_far_as_the_worst_readings_drive_them() -> None:
    """The sum of |h| of a level is 1, and that of a slope is what readings at the ends of their range make of it."""
    (one,) = fixed(channel("level", 1, 0.2)).channels
    assert bound_states(one.design, schedule_in(one.design)).settled[0] == pytest.approx(1.0, rel=1e-6)
    (two,) = fixed(channel("slope", 2, 0.05)).channels
    assert two.design.steady is not None
    F, K = two.design.model.F, two.design.steady.gain
    h, M = F @ K, F @ (np.eye(2) - K @ two.design.model.H)
    found = np.abs(np.hstack([np.linalg.matrix_power(M, k) @ h for k in range(3000)])).sum(axis=1)
    np.testing.assert_allclose(bound_states(two.design, schedule_in(two.design)).settled, found, rtol=0.02)
