"""Run a stream or a sender in a subprocess, and make readings and recipes, for the benchmarks of streams."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from becalm.cleaning.recipes.recipe import ChannelRecipe, Origin, Recipe
from becalm.cleaning.recipes.recipe_parts import GateRecipe, LimitsRecipe
from becalm.live.messages.encoding import Encoder

Floats = NDArray[np.float64]

_TICKS = os.sysconf("SC_CLK_TCK")
_LONGEST_WAIT_S = 120.0


def names_of(channels: int) -> list[str]:
    """Return channel names."""
    return [f"c{number}" for number in range(channels)]


def recipe_of(channels: int, rate_hz: float) -> Recipe:
    """Return a recipe like those tuned for accelerometers: kinematic models of order 2, a gate, limits."""
    one = ChannelRecipe(
        name="c",
        unit="m/s^2",
        model="motion",
        order=2,
        process_noise_density=1e4,
        noise_std=0.05,
        tuning_spread=0.02,
        gate=GateRecipe(),
        limits=LimitsRecipe(low=-40.0, high=40.0, stuck_readings=200),
    )
    named = tuple(one.model_copy(update={"name": name}) for name in names_of(channels))
    return Recipe(mode="causal", tuned_on=Origin(rate_hz=rate_hz), channel=named)


def readings(rows: int, channels: int, rate_hz: float, seed: int = 0) -> Floats:
    """Return readings like those of accelerometers on a car: slow motion, a vibration and white noise."""
    rng, t = np.random.default_rng(seed), np.arange(rows) / rate_hz
    phases = rng.uniform(0, 2 * np.pi, channels)
    motion = np.sin(2 * np.pi * 0.7 * t[:, None] + phases) + 0.3 * np.sin(2 * np.pi * 11.0 * t[:, None] + 2 * phases)
    return np.asarray(motion + rng.normal(0, 0.05, (rows, channels)))


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """Return a port of loopback that no program listens at."""
    with socket.socket(type=kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class LiveProcess:
    """A subprocess that runs `becalm live`.

    Attributes
    ----------
    folder : Path
        Working folder, which also gets the log.
    words : list of str
        Arguments of the command.
    """

    folder: Path
    words: list[str]
    output: int = subprocess.DEVNULL
    process: subprocess.Popen[bytes] = field(init=False)

    def __post_init__(self) -> None:
        """Start the subprocess."""
        status, log = self.folder / "status.json", self.folder / "becalm.log"
        more = ["--status", str(status), "--log", str(log)]
        command = [sys.executable, "-m", "becalm", "live", *self.words, *more]
        with (self.folder / "stderr.txt").open("ab") as errors:
            self.process = subprocess.Popen(command, cwd=self.folder, stdout=self.output, stderr=errors)

    @property
    def cpu_s(self) -> float:
        """Return the processor time that the subprocess has used, in seconds."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS

    @property
    def status(self) -> dict[str, Any]:
        """Return the last status that the stream has written; {} before the first one."""
        try:
            status: dict[str, Any] = json.loads((self.folder / "status.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return status

    def wait_for(self, state: str) -> None:
        """Wait until the status has this state."""
        until = time.monotonic() + _LONGEST_WAIT_S
        while self.status.get("state") != state:
            if self.process.poll() is not None or time.monotonic() > until:
                raise SystemExit(f"The stream did not come to {state!r}: {self.said()}")
            time.sleep(0.05)

    def said(self) -> str:
        """Return its error output."""
        return (self.folder / "stderr.txt").read_text(encoding="utf-8")

    def kill(self) -> None:
        """Kill the subprocess with SIGKILL."""
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        """Stop the subprocess with SIGTERM; return its exit code."""
        with contextlib.suppress(ProcessLookupError):
            self.process.send_signal(signal.SIGTERM)
        return self.process.wait(_LONGEST_WAIT_S)


@dataclass(frozen=True)
class Sending:
    """The rows that a sender sends in datagrams, at an even rate."""

    port: int
    channels: int
    rate_hz: float
    datagram_s: float
    seconds: float


def send(sending: Sending) -> None:
    """Send rows over loopback like an instrument: each datagram at the time of its last row."""
    per = max(1, round(sending.datagram_s * sending.rate_hz))
    count = round(sending.seconds * sending.rate_hz / per)
    values = readings(per * 100, sending.channels, sending.rate_hz)
    names, encoder = names_of(sending.channels), Encoder("arrow")
    begun = time.time() + 0.2
    with socket.socket(type=socket.SOCK_DGRAM) as wire:
        wire.connect(("127.0.0.1", sending.port))
        for number in range(count):
            first = number * per
            at = first % (per * 100)
            columns: dict[str, Floats] = {"time": begun + (first + np.arange(per)) / sending.rate_hz}
            columns |= {name: values[at : at + per, channel] for channel, name in enumerate(names)}
            message = encoder.message(columns, first)
            late_s = begun + (first + per) / sending.rate_hz - time.time()
            if late_s > 0:
                time.sleep(late_s)
            wire.send(message)


@contextlib.contextmanager
def sender(sending: Sending) -> Iterator[subprocess.Popen[bytes]]:
    """Send rows from a subprocess until the block ends."""
    words = [str(value) for value in vars(sending).values()]
    process = subprocess.Popen([sys.executable, __file__, *words])
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def stolen_share(before: tuple[int, int], after: tuple[int, int]) -> float:
    """Return the share of processor time that the host of the virtual machine took between two calls."""
    total = after[1] - before[1]
    return (after[0] - before[0]) / total if total else 0.0


def processor_time() -> tuple[int, int]:
    """Return the stolen and the total processor time, in ticks."""
    ticks = [int(word) for word in Path("/proc/stat").read_text(encoding="ascii").splitlines()[0].split()[1:9]]
    return ticks[7], sum(ticks)


if __name__ == "__main__":
    port, channels, rate_hz, datagram_s, seconds = sys.argv[1:]
    send(Sending(int(port), int(channels), float(rate_hz), float(datagram_s), float(seconds)))
