"""Brokers for tests: skipped where they are not installed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import live_brokers
from live_brokers import DEADLINE_S, Broker, certified
from servers import need

__all__ = ["DEADLINE_S", "Broker", "certified", "mosquitto", "nats_as_mqtt", "nats_server"]


def mosquitto(folder: Path, **more: Any) -> Broker:
    """Make a mosquitto, where one is installed."""
    need("mosquitto")
    return live_brokers.mosquitto(folder, **more)


def nats_server(folder: Path, *more: str) -> Broker:
    """Make a NATS server, where one is installed."""
    _need_nats()
    return live_brokers.nats_server(folder, *more)


def nats_as_mqtt(folder: Path) -> Broker:
    """Make a NATS server that speaks MQTT, where one is installed."""
    _need_nats()
    return live_brokers.nats_as_mqtt(folder)


def _need_nats() -> None:
    if not Path(sys.executable).with_name("nats-server").exists():  # where pip puts it
        need("nats-server")
