"""Run real brokers on loopback, which tests and benchmarks can kill and restart on the same port and store."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from live_programs import free_port, program_path

DEADLINE_S = 30.0


class Broker:
    """The process of a broker, a context manager that starts and ends it."""

    def __init__(self, command: list[str], port: int, folder: Path) -> None:
        self.command = command
        self.port = port
        self.folder = folder
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the broker, and wait until it accepts connections."""
        with (self.folder / "broker.log").open("ab") as log:
            self._process = subprocess.Popen(self.command, stdout=log, stderr=subprocess.STDOUT, cwd=self.folder)
        end = time.monotonic() + DEADLINE_S
        while time.monotonic() < end:
            if self._process.poll() is not None:
                break
            try:
                socket.create_connection(("127.0.0.1", self.port), 1.0).close()
            except OSError:
                time.sleep(0.02)
            else:
                return
        raise RuntimeError(f"{self.command[0]} did not start: {(self.folder / 'broker.log').read_text()[-2000:]}")

    def kill(self) -> None:
        """Kill the broker with SIGKILL, so that it writes no more data."""
        self._end(signal.SIGKILL)

    def send(self, what: signal.Signals) -> None:
        """Send a signal to the process: SIGSTOP halts it, SIGCONT continues it."""
        assert self._process is not None
        self._process.send_signal(what)

    def _end(self, how: signal.Signals) -> None:
        if self._process is not None:
            self._process.send_signal(how)
            self._process.wait(DEADLINE_S)
            self._process = None

    def __enter__(self) -> Self:
        """Start the broker."""
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End the broker with SIGTERM."""
        self._end(signal.SIGTERM)


def mosquitto(
    folder: Path,
    *,
    passwords: dict[str, str] | None = None,
    certificate: Path | None = None,
    more: Sequence[str] = (),
) -> Broker:
    """Return a mosquitto with the default settings of its package, except for port, store and access.

    Parameters
    ----------
    folder : Path
        Folder of its settings and its store.
    passwords : dict of str to str, optional
        Passwords of the users; without it, everybody may connect.
    certificate : Path, optional
        Folder from `certified`: the broker then accepts only TLS.
    more : sequence of str
        Further lines of the settings.
    """
    program = _program("mosquitto")
    port = free_port()
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["persistence true", f"persistence_location {folder}/", f"listener {port} 127.0.0.1", *more]
    if os.geteuid() == 0:
        lines.insert(0, "user root")  # otherwise it drops the rights of root, and cannot write its store
    if certificate is not None:
        lines += [f"{what} {certificate / name}" for what, name in (("certfile", "cert.pem"), ("keyfile", "key.pem"))]
    lines.append(f"allow_anonymous {'true' if passwords is None else 'false'}")
    if passwords is not None:
        file = folder / "passwords"
        file.write_text("".join(f"{user}:{word}\n" for user, word in passwords.items()))
        file.chmod(0o600)
        subprocess.run([_program("mosquitto_passwd"), "-U", str(file)], check=True)
        lines.append(f"password_file {file}")
    settings = folder / "mosquitto.conf"
    settings.write_text("\n".join(lines) + "\n")
    return Broker([program, "-c", str(settings)], port, folder)


def nats_server(folder: Path, *more: str) -> Broker:
    """Return a NATS server with JetStream in `folder`; `more` are further arguments."""
    port = free_port()
    folder.mkdir(parents=True, exist_ok=True)
    command = [_program("nats-server"), "-a", "127.0.0.1", "-p", str(port), "-js", "-sd", str(folder / "store"), *more]
    return Broker(command, port, folder)


def nats_as_mqtt(folder: Path) -> Broker:
    """Return a NATS server whose port accepts MQTT; it stores messages on disk."""
    server = nats_server(folder)
    settings = folder / "nats.conf"
    settings.write_text(f'server_name: pump\nmqtt {{ listen: "127.0.0.1:{free_port()}" }}\n')
    port = int(settings.read_text().rpartition(":")[2].split('"')[0])
    return Broker([*server.command, "-c", str(settings)], port, folder)


def certified(folder: Path) -> Path:
    """Write cert.pem and key.pem, self-signed for localhost and 127.0.0.1, to a folder; return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    key, cert = folder / "key.pem", folder / "cert.pem"
    asked = ["-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost"]
    names = ["-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1"]
    command = [_program("openssl"), "req", *asked, *names, "-keyout", str(key), "-out", str(cert)]
    subprocess.run(command, check=True, capture_output=True)
    return folder


def _program(name: str) -> str:
    installed = Path(sys.executable).with_name(name)  # pip puts nats-server there
    found = str(installed) if installed.exists() else program_path(name)
    if found is None:
        raise FileNotFoundError(f"{name} is not installed here")
    return found
