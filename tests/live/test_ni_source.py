"""A data-acquisition device, played by a stand-in: no hardware and no driver was there, and none is needed here."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import nidaqmx
import numpy as np
import pytest
from nidaqmx import errors, stream_readers
from nidaqmx.constants import AcquisitionType, TerminalConfiguration

from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.live.address import Address
from becalm.live.protocols import AwayError
from becalm.live.sources.ni import NiSource


class StandIn:
    """A task of two channels that has counted up to `avail_samp_per_chan` rows; it is all parts of itself."""

    failure: Exception | None = None
    made: list[StandIn] = []  # noqa: RUF012  (emptied by the fixture)

    def __init__(self) -> None:
        self.ai_channels = self.timing = self.in_stream = self
        self.channel_names = ["Dev1/ai0", "Dev1/ai1"]
        self.avail_samp_per_chan = self.given = 0
        self.samp_clk_rate = 0.0
        self.told: dict[str, Any] = {}
        self.running = self.closed = False
        StandIn.made.append(self)

    def add_ai_voltage_chan(self, channels: str, **told: Any) -> None:
        if self.failure is not None:
            raise self.failure
        self.told |= {"channels": channels, **told}

    def cfg_samp_clk_timing(self, rate_hz: float, **told: Any) -> None:
        self.samp_clk_rate = rate_hz * 1.001  # devices have the rates that they have
        self.told |= told

    def start(self) -> None:
        self.running = True

    def close(self) -> None:
        assert not self.closed
        self.closed = True

    def read_many_sample(self, data: Floats, count: int, timeout: float) -> int:
        if self.failure is not None:
            raise self.failure
        assert self.running
        assert count <= self.avail_samp_per_chan
        data[0] = np.arange(self.given, self.given + count)
        data[1] = -data[0]
        self.given += count
        self.avail_samp_per_chan -= count
        return count


@pytest.fixture
def source(monkeypatch: pytest.MonkeyPatch) -> Iterator[NiSource]:
    monkeypatch.setattr(nidaqmx, "Task", StandIn)
    monkeypatch.setattr(stream_readers, "AnalogMultiChannelReader", lambda task: task)
    monkeypatch.setattr(StandIn, "made", [])
    one = NiSource(Address.parsed("ni:Dev1/ai0:1?rate=1000&range=5&wiring=diff"))
    yield one
    one.close()
    assert all(task.closed for task in StandIn.made)


def test_rows_are_counted_by_the_device(source: NiSource) -> None:
    source.open("")
    (task,) = StandIn.made
    assert task.told["channels"] == "Dev1/ai0:1"
    assert (task.told["min_val"], task.told["max_val"]) == (-5.0, 5.0)
    assert task.told["terminal_config"] is TerminalConfiguration.DIFF
    assert task.told["sample_mode"] is AcquisitionType.CONTINUOUS
    assert task.told["samps_per_chan"] == 10_000
    task.avail_samp_per_chan = 9
    assert source.read(0.005) is None  # less than the 10 ms of a block
    task.avail_samp_per_chan = 25
    first = source.read(1.0)
    task.avail_samp_per_chan = 10
    second = source.read(1.0)
    assert first is not None
    assert second is not None
    assert (first.names, first.units) == (("ai0", "ai1"), ("V", "V"))
    assert (len(first), len(second)) == (25, 10)
    rows = np.concatenate([first.values, second.values])
    np.testing.assert_array_equal(rows, np.arange(35)[:, None] * [1, -1])
    assert first.values.flags.c_contiguous
    assert source.rate_hz == pytest.approx(1001.0)
    np.testing.assert_allclose(np.diff(np.concatenate([first.time_s, second.time_s])), 1 / 1001, atol=1e-6)
    source.committed("")


def test_channels_may_have_names_and_units(source: NiSource) -> None:
    named = NiSource(Address.parsed("ni:Dev1/ai0:1?rate=10&columns=bridge (mV),supply&rows=3"))
    named.open("")
    StandIn.made[-1].avail_samp_per_chan = 3
    block = named.read(1.0)
    assert block is not None
    assert (block.names, block.units) == (("bridge (mV)", "supply"), ("mV", "V"))
    assert block.values.tolist() == [[0.0, -0.0], [1000.0, -1.0], [2000.0, -2.0]]
    named.close()


@pytest.mark.parametrize(("names", "said"), [("ax (g),ay (g)", "cannot be converted"), ("bridge", "columns= is 1")])
def test_names_must_fit(source: NiSource, names: str, said: str) -> None:
    misnamed = NiSource(Address.parsed(f"ni:Dev1/ai0:1?rate=10&columns={names}"))
    with pytest.raises(UsageError, match=said):
        misnamed.open("")
    misnamed.close()


def test_a_device_that_stops_is_away(source: NiSource) -> None:
    source.open("")
    (task,) = StandIn.made
    task.avail_samp_per_chan = 100
    task.failure = errors.DaqReadError("The samples are no longer available.\n\nTask Name: x", -200279, 0)
    with pytest.raises(AwayError, match=r"stopped: The samples are no longer available\.$"):
        source.read(1.0)
    source.open("")
    assert task.closed
    source.close()
    source.close()
    with pytest.raises(AwayError, match="is closed"):
        source.read(0.0)


@pytest.mark.parametrize(
    ("failure", "kind", "said"),
    [
        (errors.DaqError("Device identifier is invalid.", -200220), AwayError, "cannot be reached: Device"),
        (errors.DaqError("The rate is too high.", -200077), UsageError, "does not support these settings: The rate"),
    ],
)
def test_what_the_driver_refuses_is_said(
    source: NiSource, monkeypatch: pytest.MonkeyPatch, failure: Exception, kind: type[Exception], said: str
) -> None:
    monkeypatch.setattr(StandIn, "failure", failure)
    with pytest.raises(kind, match=said):
        source.open("")


def test_a_missing_driver_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent() -> None:
        raise errors.DaqNotFoundError("Could not find an installation of NI-DAQmx.")

    monkeypatch.setattr(nidaqmx, "Task", absent)
    with pytest.raises(UsageError, match="get NI-DAQmx from"):
        NiSource(Address.parsed("ni:Dev1/ai0?rate=1000")).open("")


def test_a_long_block_has_room_and_its_beginning_is_read_at_the_end(source: NiSource) -> None:
    patient = NiSource(Address.parsed("ni:Dev1/ai0:1?rate=1000&rows=20000"))
    patient.open("")
    task = StandIn.made[-1]
    assert task.told["samps_per_chan"] >= 2 * 20_000
    task.avail_samp_per_chan = 900
    assert patient.read(0.001) is None
    rest = patient.read(0.0)  # as the reader does before it stops
    assert rest is not None
    assert len(rest) == 900
    assert patient.read(0.0) is None
    patient.close()
