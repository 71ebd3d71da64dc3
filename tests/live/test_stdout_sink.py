"""Clean rows as text: each number comes back to the bit, at once, and a reader that has gone is a sentence."""

from __future__ import annotations

import csv
import json
import os
import sys
import threading
from collections.abc import Iterator
from io import FileIO
from pathlib import Path

import numpy as np
import pyarrow.csv as arrow_csv
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from becalm.core.arrays import Floats
from becalm.errors import OutputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Head, Output
from becalm.live.lines.columns import LineOptions
from becalm.live.lines.line_parser import LineParser
from becalm.live.sinks.stdout import StdoutSink


def _head(names: tuple[str, ...] = ("ax (g)", "b")) -> Head:
    return Head(names, ("",) * len(names), 100.0, "")


def _output(time_s: Floats, signal: Floats, sigma: Floats) -> Output:
    return Output(0, time_s, signal, signal, sigma, np.zeros(signal.shape, np.int8))


def _written(text: str, head: Head, *outputs: Output, blocking: bool = True) -> bytes:
    """Write outputs into a pipe, and return what came out of it."""
    reader, writer = os.pipe()
    os.set_blocking(writer, blocking)
    came: list[bytes] = []

    def read() -> None:
        with FileIO(reader) as end:
            came.append(end.read())

    thread = threading.Thread(target=read)
    thread.start()
    sink = StdoutSink(Address.parsed(text), writer)
    sink.open(head)
    for output in outputs:
        sink.write(output)
    sink.flush()
    sink.open(head)  # again, as after a break
    sink.close()
    os.close(writer)
    thread.join()
    return came[0]


_VALUES = arrays(np.float64, (3, 2), elements=st.floats(allow_infinity=False))
_TIMES = arrays(np.float64, 3, elements=st.floats(allow_infinity=False, allow_nan=False))


@given(_TIMES, _VALUES, _VALUES)
def test_csv_gives_each_number_back_to_the_bit(time_s: Floats, signal: Floats, sigma: Floats) -> None:
    text = _written("stdout:", _head(), _output(time_s, signal, sigma))
    rows = list(csv.reader(text.decode().splitlines()))
    assert rows[0] == ["time", "ax (g)", "ax (g)_sigma", "b", "b_sigma"]
    read = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows[1:]])
    np.testing.assert_array_equal(read[:, 0], time_s)
    np.testing.assert_array_equal(read[:, 1::2], signal)
    np.testing.assert_array_equal(read[:, 2::2], sigma)


@given(_TIMES, _VALUES, _VALUES)
def test_json_gives_each_number_back_to_the_bit(time_s: Floats, signal: Floats, sigma: Floats) -> None:
    text = _written("stdout:?format=json", _head(('100 %s "x"', "b")), _output(time_s, signal, sigma))
    rows = [json.loads(line, parse_constant=pytest.fail) for line in text.decode().splitlines()]
    read = np.array([[np.nan if row[name] is None else row[name] for name in rows[0]] for row in rows])
    assert list(rows[0]) == ["time", '100 %s "x"', '100 %s "x"_sigma', "b", "b_sigma"]
    np.testing.assert_array_equal(read[:, 0], time_s)
    np.testing.assert_array_equal(read[:, 1::2], signal)
    np.testing.assert_array_equal(read[:, 2::2], sigma)


@pytest.mark.parametrize("form", ["csv", "json"])
def test_the_next_becalm_reads_it(form: str) -> None:
    signal = np.array([[1.0, np.nan], [3.0, 4.0]])
    text = _written(f"stdout:?format={form}", _head(), _output(np.array([0.5, 1.5]), signal, signal / 8))
    block = LineParser(LineOptions()).feed(text, 0.0)
    assert block is not None
    assert not block.losses
    assert block.time_s.tolist() == [0.5, 1.5]
    np.testing.assert_array_equal(block.values[:, [0, 2]], signal)


def test_other_programs_read_it(tmp_path: Path) -> None:
    signal = np.random.default_rng(1).normal(size=(5000, 2))
    time_s = np.arange(5000) / 7
    parts = [slice(start, start + 1000) for start in range(0, 5000, 1000)]
    outputs = [_output(time_s[part], signal[part], signal[part]) for part in parts]
    file = tmp_path / "out.csv"
    file.write_bytes(_written("stdout:", _head(("a,b", 'c"d')), *outputs))
    table = arrow_csv.read_csv(file)
    assert table.column_names == ["time", "a,b", "a,b_sigma", 'c"d', 'c"d_sigma']
    np.testing.assert_array_equal(table["a,b"].to_numpy(), signal[:, 0])
    np.testing.assert_array_equal(table["time"].to_numpy(), time_s)


def test_nothing_is_written_of_no_rows() -> None:
    none = _output(np.empty(0), np.empty((0, 2)), np.empty((0, 2)))
    assert _written("stdout:?format=json", _head(), none) == b""


@pytest.fixture
def broken() -> Iterator[int]:
    reader, writer = os.pipe()
    os.close(reader)
    yield writer
    os.close(writer)


def test_a_reader_that_has_gone_is_a_sentence(broken: int) -> None:
    sink = StdoutSink(Address.parsed("stdout:"), broken)
    with pytest.raises(OutputError, match="has ended"):
        sink.open(_head())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_a_full_disk_is_a_sentence() -> None:
    with Path("/dev/full").open("wb", buffering=0) as full:
        sink = StdoutSink(Address.parsed("stdout:?format=json"), full.fileno())
        sink.open(_head())
        with pytest.raises(OutputError, match="No space left"):
            sink.write(_output(np.zeros(1), np.zeros((1, 2)), np.zeros((1, 2))))


def test_a_closed_output_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "__stdout__", None)
    with pytest.raises(OutputError, match="is closed"):
        StdoutSink(Address.parsed("stdout:")).open(_head())


def test_an_output_that_does_not_wait_is_waited_for() -> None:
    signal = np.random.default_rng(2).normal(size=(20_000, 2))
    text = _written("stdout:", _head(), _output(np.arange(20_000.0), signal, signal), blocking=False)
    assert text.count(b"\n") == 20_001


@pytest.mark.parametrize(("text", "said"), [("stdout:x", "takes no name"), ("stdout:?format=xml", "format=xml")])
def test_impossible_wishes_are_refused(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        StdoutSink(Address.parsed(text))
