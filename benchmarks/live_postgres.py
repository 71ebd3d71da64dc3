"""A real PostgreSQL on loopback that tests and benchmarks start, kill and start again."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from live_programs import free_port, program_path

USER, PASSWORD = "keeper", "a secret: 'quoted' \\ word"
_PATIENCE_S = 30.0
_SETTINGS = {
    "max_connections": "20",
    "shared_buffers": "32MB",
    "lc_messages": "C",
    "fsync": "off",  # what a killed process wrote stays with the system; only a power cut takes it
}


class PostgresServer:
    """One server with one user, one password and one data folder; it lives through kills.

    Parameters
    ----------
    folder : Path
        Whose it is; the folder must be reachable for the user who runs the server, as those of `postgres_folder` are.
    """

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.data, self.password_file = folder / "data", folder / "password"
        self._log, self._settings = folder / "log", dict(_SETTINGS)
        self._process: subprocess.Popen[bytes] | None = None
        self._bare: dict[str, Any] = {"user": "postgres", "group": "postgres"} if os.geteuid() == 0 else {}
        self.password_file.write_text(f"{PASSWORD}\n", encoding="utf-8")
        if self._bare:
            for path in (folder, self.password_file):
                shutil.chown(path, **self._bare)
        command = [
            _program("initdb"),
            "-D",
            str(self.data),
            "-U",
            USER,
            "-A",
            "scram-sha-256",
            "--pwfile",
            str(self.password_file),
        ]
        made = subprocess.run(
            [*command, "-N", "-E", "UTF8", "--locale=C"],
            capture_output=True,
            text=True,
            check=False,
            cwd=folder,
            **self._bare,
        )
        assert made.returncode == 0, made.stderr

    def start(self, **settings: str) -> None:
        """Start it, with settings that it keeps, and wait until it answers on its port."""
        self._settings |= settings
        said = {**self._settings, "port": str(self.port), "unix_socket_directories": str(self.data)}
        words = [word for name, value in said.items() for word in ("-c", f"{name}={value}")]
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                [_program("postgres"), "-D", self.data, "-c", "listen_addresses=127.0.0.1", *words],
                stdout=log,
                stderr=log,
                cwd=self.data,
                start_new_session=True,
                **self._bare,
            )
        self._wait()

    def kill(self) -> None:
        """Kill it and all its children at once."""
        if self._process is not None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._process = None

    def stop(self) -> None:
        """Stop it in its own way, and quickly."""
        if self._process is not None:
            self._process.send_signal(signal.SIGQUIT)
            self._process.wait()
            self._process = None

    def connect(self) -> Any:
        """Return a connection of a person who looks."""
        import psycopg

        return psycopg.connect(
            host="127.0.0.1", port=self.port, dbname="postgres", user=USER, password=PASSWORD, autocommit=True
        )

    def do(self, statements: str) -> None:
        """Let a person do something."""
        with self.connect() as connection:
            connection.execute(statements)

    def asked(self, query: str) -> list[tuple[Any, ...]]:
        """Return what a query tells."""
        with self.connect() as connection:
            answer: list[tuple[Any, ...]] = connection.execute(query).fetchall()
        return answer

    def _wait(self) -> None:
        import psycopg

        deadline = time.monotonic() + _PATIENCE_S
        while True:
            with suppress(psycopg.OperationalError), self.connect():
                return
            running = self._process is not None and self._process.poll() is None
            assert running, self._log.read_text(errors="replace")
            assert time.monotonic() < deadline, self._log.read_text(errors="replace")
            time.sleep(0.02)


@contextmanager
def postgres_server(**settings: str) -> Iterator[PostgresServer]:
    """Run a server in a folder of its own, which pytest's own would not let another user reach."""
    with tempfile.TemporaryDirectory(prefix="becalm-postgres-", ignore_cleanup_errors=True) as name:
        server = PostgresServer(Path(name))
        try:
            server.start(**settings)
            yield server
        finally:
            server.kill()


def _program(name: str) -> str:
    path = program_path(name)
    if path is None:
        raise SystemExit(f"{name} is not installed here; Debian has it: apt-get install postgresql")
    return path


__all__ = ["PASSWORD", "USER", "PostgresServer", "postgres_server"]
