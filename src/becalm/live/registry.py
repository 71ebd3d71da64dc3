"""Make the source or sink of a command-line address; each transport is imported only when it is used."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, cast

from becalm.errors import UsageError
from becalm.live.address import Address

if TYPE_CHECKING:
    from becalm.live.protocols import CheckpointSink, Sink, Source

SOURCES = {
    "replay": "becalm.live.sources.replay:ReplaySource",
    "stdin": "becalm.live.sources.stdin:StdinSource",
    "serial": "becalm.live.sources.serial:SerialSource",
    "udp": "becalm.live.sources.udp:UdpSource",
    "mqtt": "becalm.live.sources.mqtt:MqttSource",
    "nats": "becalm.live.sources.nats:NatsSource",
    "visa": "becalm.live.sources.visa:VisaSource",
    "ni": "becalm.live.sources.ni:NiSource",
}
"""Module and class of each kind of source; the class takes an `Address`."""

SINKS = {
    "stdout": "becalm.live.sinks.stdout:StdoutSink",
    "journal": "becalm.live.journal.journal:Journal",
    "parquet": "becalm.live.sinks.parquet:ParquetSink",
    "mqtt": "becalm.live.sinks.mqtt:MqttSink",
    "nats": "becalm.live.sinks.nats:NatsSink",
    "postgres": "becalm.live.sinks.postgres:PostgresSink",
    "delta": "becalm.live.sinks.delta:DeltaSink",
}
"""Module and class of each kind of sink; the class takes an `Address`."""


def open_source(text: str) -> Source:
    """Make the source of an address; it is not opened yet.

    Raises
    ------
    UsageError
        If the kind or an option is unknown.
    """
    return cast("Source", _make(text, SOURCES, "source"))


def open_sink(text: str) -> Sink | CheckpointSink:
    """Make the sink of an address; it is not opened yet.

    Raises
    ------
    UsageError
        If the kind or an option is unknown.
    """
    return cast("Sink | CheckpointSink", _make(text, SINKS, "sink"))


def _make(text: str, kinds: dict[str, str], what: str) -> object:
    address = Address.parsed(text)
    if address.kind not in kinds:
        raise UsageError(
            f"{address.kind}: is not a {what} of becalm; use one of {', '.join(f'{kind}:' for kind in kinds)}."
        )
    module, _, name = kinds[address.kind].partition(":")
    return getattr(import_module(module), name)(address)
