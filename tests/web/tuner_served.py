"""The tuner on a real server of loopback, and a page that speaks with it."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import numpy as np
from numpy.typing import NDArray
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from becalm.core.recording import Recording
from becalm.files.outputs.writing import write
from becalm.files.read_options import ReadOptions
from becalm.web.access import LOOPBACK, Access
from becalm.web.frames import unframed
from becalm.web.serving import Server, listen
from becalm.web.site import Page, site
from becalm.web.tuner import Tuner
from becalm.web.tuner.opened import AS_IT_IS
from served import HTML, LIMIT_BYTES, PATIENCE_S, TOKEN

ROWS, RATE_HZ = 6000, 500.0


class Heard(NamedTuple):
    """What the tuner told: a message, or a frame with its arrays."""

    told: dict[str, Any]
    arrays: dict[str, NDArray[Any]]

    @property
    def kind(self) -> str:
        return str(self.told["kind"])


class Talk:
    """A page in conversation with the tuner."""

    def __init__(self, wire: ClientConnection) -> None:
        self.wire, self._number = wire, 0
        self.heard: list[Heard] = []

    def ask(self, do: str, **more: Any) -> int:
        """Ask for something; return the number of the message."""
        self._number += 1
        self.wire.send(json.dumps({"number": self._number, "do": do, **more}))
        return self._number

    def hear(self) -> Heard:
        """Return what comes next."""
        data = self.wire.recv(PATIENCE_S)
        self.heard.append(Heard(json.loads(data), {}) if isinstance(data, str) else Heard(*unframed(data)))
        return self.heard[-1]

    def until(self, kind: str, which: Callable[[Heard], bool] = lambda _: True) -> Heard:
        """Return the first of a kind that comes."""
        while not ((heard := self.hear()).kind == kind and which(heard)):
            pass
        return heard

    def picture(self, number: int) -> Heard:
        """Return the picture that answers a message."""
        return self.until("picture", lambda heard: heard.told["answers"] >= number)

    def opened(self, file: str) -> dict[str, Any]:
        """Open a file; return what is told of it, once it is shown."""
        number = self.ask("open", file=file)
        recording = self.until("recording").told
        self.until("picture")
        assert number
        return recording


class Served(NamedTuple):
    """The tuner, served."""

    tuner: Tuner
    access: Access
    folder: Path

    @property
    def base(self) -> str:
        return f"http://{LOOPBACK}:{self.access.port}"

    def client(self) -> httpx.Client:
        """Return a browser that has been let in."""
        cookie = {"cookie": f"{self.access.cookie}={TOKEN}"}
        return httpx.Client(base_url=self.base, headers=cookie, timeout=PATIENCE_S, trust_env=False)

    @contextmanager
    def talk(self) -> Iterator[Talk]:
        """Open a page."""
        with connect(
            f"ws://{LOOPBACK}:{self.access.port}/wire",
            origin=Origin(self.base),
            additional_headers=[("Cookie", f"{self.access.cookie}={TOKEN}")],
            sock=socket.create_connection((LOOPBACK, self.access.port)),
            open_timeout=PATIENCE_S,
            max_size=None,
            proxy=None,
        ) as wire:
            yield Talk(wire)


@contextmanager
def served(folder: Path, file: Path | None = None, options: ReadOptions = AS_IT_IS) -> Iterator[Served]:
    """Serve the tuner."""
    listener = listen(LOOPBACK, 0)
    access = Access(LOOPBACK, listener.getsockname()[1], TOKEN)
    tuner = Tuner(folder, file, LIMIT_BYTES, options)
    try:
        with Server(listener, site(Page(HTML, tuner.wire, tuner.routes), access)):
            yield Served(tuner, access, folder)
    finally:
        tuner.close()


def drive(seed: int = 1) -> Recording:
    """A test drive of two channels: a wave with a hum and spikes, and a random walk."""
    rng = np.random.default_rng(seed)
    t = np.arange(ROWS) / RATE_HZ
    wave = np.sin(2 * np.pi * 0.7 * t) + 0.3 * np.sin(2 * np.pi * 50 * t) + 0.2 * rng.normal(size=ROWS)
    wave[[1500, 4000]] += 25.0
    walk = np.cumsum(rng.normal(size=ROWS)) * 0.02 + rng.normal(size=ROWS)
    return Recording(np.column_stack([wave, walk]), names=["ax", "load"], units=["m/s^2", "N"], rate_hz=RATE_HZ)


def drive_in(folder: Path, name: str = "drive.csv") -> Path:
    """Write the test drive into a folder."""
    write(folder / name, drive())
    return folder / name
