"""Run a real PostgreSQL server on loopback, which tests and benchmarks can kill and restart."""

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
    "fsync": "off",  # after a kill the system still has all written data; only a power cut would lose them
}


class PostgresServer:
    """A server with one user, one password and one data folder, which outlives kills.

    Parameters
    ----------
    folder : Path
        Folder of its files; the user who runs the server must be able to enter it.
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
        """Start the server and wait until it answers; the settings also apply to later starts."""
        self._settings |= settings
        all_settings = {**self._settings, "port": str(self.port), "unix_socket_directories": str(self.data)}
        words = [word for name, value in all_settings.items() for word in ("-c", f"{name}={value}")]
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
        """Kill the server and all its child processes at once."""
        if self._process is not None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._process = None

    def stop(self) -> None:
        """Stop the server with SIGQUIT."""
        if self._process is not None:
            self._process.send_signal(signal.SIGQUIT)
            self._process.wait()
            self._process = None

    def connect(self) -> Any:
        """Return a connection to the server."""
        import psycopg

        return psycopg.connect(
            host="127.0.0.1", port=self.port, dbname="postgres", user=USER, password=PASSWORD, autocommit=True
        )

    def do(self, statements: str) -> None:
        """Execute SQL statements."""
        with self.connect() as connection:
            connection.execute(statements)

    def asked(self, query: str) -> list[tuple[Any, ...]]:
        """Return the rows of a query."""
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
    """Run a server in a temporary folder; other users could not enter pytest's folders."""
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
