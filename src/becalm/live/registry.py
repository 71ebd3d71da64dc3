"""Which transport a name on the command line means; each is loaded when it is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, cast

from becalm.errors import UsageError
from becalm.live.address import Address

if TYPE_CHECKING:
    from becalm.live.protocols import Keeper, Sink, Source

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
"""Where each kind of source is made: a class that takes its address."""

SINKS = {
    "stdout": "becalm.live.sinks.stdout:StdoutSink",
    "journal": "becalm.live.journal.keeper:Journal",
    "parquet": "becalm.live.sinks.parquet:ParquetSink",
    "mqtt": "becalm.live.sinks.mqtt:MqttSink",
    "nats": "becalm.live.sinks.nats:NatsSink",
    "postgres": "becalm.live.sinks.postgres:PostgresSink",
    "delta": "becalm.live.sinks.delta:DeltaSink",
}
"""The same of sinks."""


def open_source(text: str) -> Source:
    """Make the source that a text names; nothing is reached yet.

    Raises
    ------
    UsageError
        If there is no such kind, or no such option.
    """
    return cast("Source", _made(text, SOURCES, "source"))


def open_sink(text: str) -> Sink | Keeper:
    """Make the sink that a text names; nothing is reached yet.

    Raises
    ------
    UsageError
        If there is no such kind, or no such option.
    """
    return cast("Sink | Keeper", _made(text, SINKS, "sink"))


def _made(text: str, kinds: dict[str, str], what: str) -> object:
    address = Address.parsed(text)
    if address.kind not in kinds:
        raise UsageError(
            f"{address.kind}: is no {what} of becalm; there are {', '.join(f'{kind}:' for kind in kinds)}."
        )
    module, _, name = kinds[address.kind].partition(":")
    return getattr(import_module(module), name)(address)
