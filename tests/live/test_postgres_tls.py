"""postgres: over TLS, to a server whose certificate is made here."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from becalm.errors import InputError
from becalm.live.address import Address
from becalm.live.sinks.postgres import PostgresSink
from live_postgres import PASSWORD, USER, PostgresServer, postgres_server
from servers import need
from streams import checkpoint_at, head_of, outputs_of


def certificate(folder: Path, name: str) -> tuple[Path, Path]:
    """Make a certificate of 127.0.0.1 that signs itself; return it and its key."""
    made, key = folder / f"{name}.crt", folder / f"{name}.key"
    words = f"req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN={name} -addext subjectAltName=IP:127.0.0.1".split()
    command = [need("openssl"), *words, "-out", str(made), "-keyout", str(key)]
    subprocess.run(command, check=True, capture_output=True)
    return made, key


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[PostgresServer, Path]]:
    need("initdb")
    folder = tmp_path_factory.mktemp("tls")
    made, key = certificate(folder, "server")
    with postgres_server() as server:
        server.stop()
        for source in (made, key):
            target = server.data / source.name
            shutil.copy(source, target)
            target.chmod(0o600)
            if os.geteuid() == 0:
                shutil.chown(target, "postgres", "postgres")
        server.start(ssl="on", ssl_cert_file=made.name, ssl_key_file=key.name)
        yield server, made


@pytest.fixture(autouse=True)
def _known_password(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PGPASSWORD", PASSWORD)


def keeper_of(server: PostgresServer, options: str, host: str = "127.0.0.1") -> PostgresSink:
    """Return a keeper that asks for TLS in some way."""
    return PostgresSink(Address.parsed(f"postgres://{USER}@{host}:{server.port}/postgres?table=safe&{options}"))


def test_rows_go_over_tls_to_the_server_that_was_meant(guarded: tuple[PostgresServer, Path]) -> None:
    server, root = guarded
    keeper = keeper_of(server, f"sslmode=verify-full&sslrootcert={root}")
    try:
        keeper.open(head_of("a"))
        keeper.commit(outputs_of([3]), checkpoint_at(3))
        asked = "select ssl from pg_stat_ssl join pg_stat_activity using (pid) where application_name = 'becalm'"
        assert server.asked(asked) == [(True,)]
        assert keeper.last() == checkpoint_at(3)
    finally:
        keeper.close()


def test_another_servers_certificate_is_no_reason_to_wait(guarded: tuple[PostgresServer, Path], tmp_path: Path) -> None:
    server, root = guarded
    other, _ = certificate(tmp_path, "other")
    with pytest.raises(InputError, match="certificate"):
        keeper_of(server, f"sslmode=verify-full&sslrootcert={other}").last()
    with pytest.raises(InputError, match="certificate"):  # it is made for 127.0.0.1
        keeper_of(server, f"sslmode=verify-full&sslrootcert={root}", host="localhost").last()
    with pytest.raises(InputError, match="certificate"):
        keeper_of(server, f"sslmode=verify-full&sslrootcert={tmp_path}/none.crt").last()


def test_a_server_without_tls_gets_no_rows_where_tls_is_asked() -> None:
    need("initdb")
    with postgres_server() as server, pytest.raises(InputError, match="SSL"):
        keeper_of(server, "sslmode=require").last()
