"""What tests of postgres: share: fixtures of a server, and of keepers that are closed at the end."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from becalm.live.address import Address
from becalm.live.sinks.postgres import PostgresSink
from live_postgres import PASSWORD, USER, PostgresServer, postgres_server
from servers import need


def running_postgres() -> Iterator[PostgresServer]:
    """Run a server, where one is installed."""
    need("initdb")
    with postgres_server() as running:
        yield running


def closed_keepers(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[PostgresSink]]:
    """Set the password, and collect keepers, to close them all."""
    monkeypatch.setenv("PGPASSWORD", PASSWORD)
    made: list[PostgresSink] = []
    yield made
    for keeper in made:
        keeper.close()


def keeper_of(server: PostgresServer, table: str, options: str = "", host: str = "127.0.0.1") -> PostgresSink:
    """Return a keeper of one table; the caller closes it."""
    return PostgresSink(Address.parsed(f"postgres://{USER}@{host}:{server.port}/postgres?table={table}{options}"))
