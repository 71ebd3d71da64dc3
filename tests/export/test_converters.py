"""Codes of a converter in fixed point, multiplied as the header says: none is shifted, and rails are seen."""

from __future__ import annotations

import ctypes
import re

import numpy as np
import pytest

from becalm.core.reading_verdicts import Verdict
from becalm.export.fixed.text import GREATEST
from driven import UNDEFINED, Driven, library
from exported import channel, fixed

LEAST, MISSING = -GREATEST, -GREATEST - 1
FACTORS = {16: 65536, 24: 256}
RANGE = (-5.0, 5.0)


@pytest.fixture(scope="module")
def converter(tmp_path_factory: pytest.TempPathFactory) -> tuple[ctypes.CDLL, Driven]:
    """Compile a filter of readings in volts beside the products that its header shows."""
    made = fixed(channel("ax", 1, 0.2, unit="V", noise_std=0.01), span=RANGE)
    said = " ".join(made.files["drive.h"].replace("\n *", " ").split())
    assert "24-bit converter whose codes span this range a reading is code * 256, for a 16-bit one code * 65536" in said
    assert "(code - 32768) * 65536" in said
    assert "least code as INT32_MIN + 1 and the greatest as INT32_MAX" in said
    assert not re.search(r"<<|a shift to the left", said)
    shown = {f"signed_{bits}": f"code * {factor}" for bits, factor in FACTORS.items()}
    shown["unsigned_16"] = "(code - 32768) * 65536"
    more = "".join(f"int32_t {name}(int32_t code) {{ return {told}; }}\n" for name, told in shown.items())
    c = library(made, tmp_path_factory.mktemp("converter"), *UNDEFINED, more=more)
    return c, Driven(c, made.channels[0])


@pytest.mark.parametrize("bits", FACTORS)
def test_a_code_is_the_reading_it_stands_for(converter: tuple[ctypes.CDLL, Driven], bits: int) -> None:
    """Every code but the least and the greatest, of 24 bits every 997th: its volts, and back again."""
    c, held = converter
    half = 1 << (bits - 1)
    codes = np.unique([*range(1 - half, half - 1, 1 if bits == 16 else 997), -1, 0, 1, half - 2])
    counts = np.array([getattr(c, f"signed_{bits}")(code) for code in codes.tolist()], np.int32)
    volts = held.one.kind.in_unit(counts, held.one.written)
    np.testing.assert_allclose(volts, codes * (RANGE[1] - RANGE[0]) / 2.0**bits, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(held.one.kind.raw(volts, held.one.written), counts)


def test_a_code_without_a_sign_has_its_middle_off(converter: tuple[ctypes.CDLL, Driven]) -> None:
    c, _ = converter
    for code in (0, 1, 32767, 32768, 32769, 65534, 65535):
        assert c.unsigned_16(code) == c.signed_16(code - 32768)


@pytest.mark.parametrize("bits", FACTORS)
@pytest.mark.parametrize("rail", [LEAST, GREATEST])
def test_a_rail_is_clipped_and_not_missing(converter: tuple[ctypes.CDLL, Driven], bits: int, rail: int) -> None:
    """The product of the least code is what says that no reading came: so the header has it given as one more."""
    c, held = converter
    half, product = 1 << (bits - 1), getattr(c, f"signed_{bits}")
    assert product(-half) == MISSING
    inside = product(half - 2 if rail > 0 else 1 - half)
    held.init()
    told, codes = held.block([0, 0, inside, rail, rail, MISSING, 0])
    used, clipped = Verdict.USED, Verdict.CLIPPED
    assert codes[1:].tolist() == [used, used, clipped, clipped, Verdict.MISSING, used]
    assert (np.abs(told) <= GREATEST).all()
    assert told[3] == told[4] == told[5]  # a level is held where nothing is used


def test_beyond_the_range_a_reading_is_given_as_its_rail(converter: tuple[ctypes.CDLL, Driven]) -> None:
    _, held = converter
    raw = held.one.kind.raw(np.array([-7.0, 7.0, np.nan, 0.0]), held.one.written)
    assert raw.tolist() == [LEAST, GREATEST, MISSING, 0]
