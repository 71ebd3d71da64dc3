"""An instrument on a bus, played by pyvisa-sim: the strain paper's voltmeter, well and unwell."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from becalm.errors import UsageError
from becalm.live.address import Address
from becalm.live.block import LossKind
from becalm.live.protocols import AwayError
from becalm.live.sources.visa import VisaSource
from instruments import next_block

_BENCH = r"""
spec: "1.1"
devices:
  voltmeter:
    eom:
      GPIB INSTR: {q: "\n", r: "\n"}
    dialogues:
      - {q: "READ?", r: "+1.5000000E-06"}
      - {q: "BOTH?", r: "+1.5E-06,-2.5E-06"}
      - {q: "OVER?", r: "1.0,9.9E37"}
      - {q: "NAME?", r: "KEITHLEY INSTRUMENTS INC.,MODEL 2182"}
      - {q: "NONE?", r: ""}
    properties:
      source:
        default: 1.0
        getter: {q: "VOLT?", r: "{:.3f}"}
        setter: {q: "VOLT {:.3f}", r: "OK"}
        specs: {type: float}
resources:
  GPIB0::7::INSTR: {device: voltmeter}
"""


class Bench:
    """Makes sources of the voltmeter."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._made: list[VisaSource] = []

    def source(self, more: str = "", name: str = "GPIB0::7::INSTR") -> VisaSource:
        made = VisaSource(Address.parsed(f"visa:{name}?backend={self._file}@sim&timeout=50ms{more}"))
        self._made.append(made)
        made.open("")
        return made

    def close(self) -> None:
        for made in self._made:
            made.close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    file = tmp_path / "bench.yaml"
    file.write_text(_BENCH, encoding="utf-8")
    one = Bench(file)
    yield one
    one.close()


def test_each_question_is_a_row(bench: Bench) -> None:
    source = bench.source()
    before = time.time()
    blocks = [next_block(source) for _ in range(3)]
    assert [block.values.tolist() for block in blocks] == [[[1.5e-6]]] * 3
    assert {block.names for block in blocks} == {("value",)}
    stamps = [float(block.time_s[0]) for block in blocks]
    assert before <= stamps[0] <= stamps[1] <= stamps[2] <= time.time()
    assert not any(block.losses for block in blocks)
    source.committed("")


def test_several_numbers_with_names_and_units(bench: Bench) -> None:
    block = next_block(bench.source("&query=BOTH?&columns=bridge (V),supply_mV"))
    assert (block.names, block.units) == (("bridge (V)", "supply_mV"), ("V", "mV"))
    assert block.values.tolist() == [[1.5e-6, -2.5e-6]]


def test_several_numbers_without_names(bench: Bench) -> None:
    assert next_block(bench.source("&query=BOTH?")).names == ("value", "value_2")


def test_over_range_is_no_reading(bench: Bench) -> None:
    np.testing.assert_array_equal(next_block(bench.source("&query=OVER?")).values, [[1.0, np.nan]])


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("&query=NAME?", "'KEITHLEY INSTRUMENTS INC.,MODEL 2182', not a number"),
        ("&query=BOTH?&columns=only", "not a number"),
        ("&query=READ?&columns=one,two", "not 2 numbers separated by commas"),
    ],
)
def test_what_is_no_row_is_counted(bench: Bench, more: str, said: str) -> None:
    block = next_block(bench.source(more))
    assert len(block) == 0
    assert [(loss.kind, loss.rows) for loss in block.losses] == [(LossKind.GARBLED, 1)]
    assert said in block.losses[0].says


def test_an_instrument_that_is_silent_is_counted_and_then_away(bench: Bench) -> None:
    source = bench.source("&query=WHAT?")
    for _ in range(2):
        block = next_block(source)
        assert [(loss.kind, loss.rows) for loss in block.losses] == [(LossKind.MISSING, 1)]
    with pytest.raises(AwayError, match="did not answer 3 times"):
        source.read(30.0)
    source.open("")  # as a runner does; it begins to count anew
    assert next_block(source).losses


def test_an_instrument_that_talks_by_itself_is_listened_to(bench: Bench) -> None:
    source = bench.source("&query=&setup=VOLT 2.500")
    block = next_block(source)  # what it said to its set-up waits to be read
    assert "'OK'" in block.losses[0].says
    assert source.read(0.0) is None


def test_questions_keep_their_interval(bench: Bench) -> None:
    source = bench.source("&query=VOLT?&interval=1h")
    assert next_block(source).values.tolist() == [[1.0]]
    assert source.read(0.01) is None
    soon = bench.source("&interval=20ms")
    stamps = [float(next_block(soon).time_s[0]) for _ in range(4)]
    assert stamps[3] - stamps[0] >= 0.055


def test_a_closed_instrument_is_away(bench: Bench) -> None:
    source = bench.source()
    source.close()
    source.close()
    with pytest.raises(AwayError, match="is closed"):
        source.read(0.0)


def test_an_instrument_that_is_not_there_is_away() -> None:
    source = VisaSource(Address.parsed("visa:ASRL/dev/absent::INSTR?backend=@py"))
    with pytest.raises(AwayError, match="cannot be reached"):
        source.open("")
    source.close()


def test_a_library_that_is_not_there_is_said(tmp_path: Path) -> None:
    for backend in ("@carrierpigeon", f"{tmp_path}/absent.yaml@sim"):
        source = VisaSource(Address.parsed(f"visa:GPIB0::7::INSTR?backend={backend}"))
        with pytest.raises(UsageError, match="finds no VISA library") as caught:
            source.open("")
        assert "Traceback" not in str(caught.value)
