"""The brokers of the benchmarks, for tests that are skipped where a program is absent."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import live_brokers
from live_brokers import DEADLINE_S, Broker
from servers import need

__all__ = ["DEADLINE_S", "Broker", "certified", "mosquitto", "nats_as_mqtt", "nats_server"]


def mosquitto(
    folder: Path,
    *,
    passwords: dict[str, str] | None = None,
    certificate: Path | None = None,
    more: Sequence[str] = (),
) -> Broker:
    """Make a mosquitto, as `live_brokers.mosquitto` does."""
    need("mosquitto")
    return live_brokers.mosquitto(folder, passwords=passwords, certificate=certificate, more=more)


def nats_server(folder: Path, *more: str) -> Broker:
    """Make a NATS server, as `live_brokers.nats_server` does."""
    if not live_brokers.NATS.exists():
        need("nats-server")
    return live_brokers.nats_server(folder, *more)


def nats_as_mqtt(folder: Path) -> Broker:
    """Make a NATS server that speaks MQTT, as `live_brokers.nats_as_mqtt` does."""
    if not live_brokers.NATS.exists():
        need("nats-server")
    return live_brokers.nats_as_mqtt(folder)


def certified(folder: Path) -> Path:
    """Fill a folder with a certificate, as `live_brokers.certified` does."""
    need("openssl")
    return live_brokers.certified(folder)
