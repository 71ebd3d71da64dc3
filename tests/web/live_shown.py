"""A live page on a real server of loopback, fed by hand; and browsers' ends of its wire."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from becalm.cleaning.recipes import recipe as recipes
from becalm.cleaning.recipes.recipe import ChannelRecipe, Recipe
from becalm.cleaning.recipes.recipe_parts import ModeRecipe, SwitchingRecipe
from becalm.live.block import Head, Output
from becalm.live.running.retuning import RetuneCallback
from becalm.live.watching.meter import Meter
from becalm.web.access import LOOPBACK, Access
from becalm.web.frames import unframed
from becalm.web.livepage.feed import Feed
from becalm.web.livepage.page import LivePage
from becalm.web.livepage.session import converse
from becalm.web.serving import Server, listen
from becalm.web.site import Page, site

PATIENCE_S = 30.0
TOKEN = "a-token-that-is-long-enough-for-all"
RATE_HZ = 1500.0
SENT_BYTES = 1 << 16  # and not taken yet, of each page
EACH = 10  # rows of a bin of level 0 at this rate
NAMES = ("ax", "tilt")


def recipe_of(density: float = 1.0) -> Recipe:
    """Return a recipe of a motion, and of a channel that switches."""
    still = ModeRecipe(name="still", order=1, process_noise_density=0.01, noise_std=1.0, lasts_s=4.0)
    moving = ModeRecipe(name="moving", order=2, process_noise_density=3e3, noise_std=1.1, lasts_s=1.0)
    switching = SwitchingRecipe(kind="resting", mode=(still, moving))
    numbers: dict[str, Any] = {"model": "motion", "order": 2, "process_noise_density": density, "noise_std": 0.5}
    channels = (
        ChannelRecipe(name=NAMES[0], unit="m", **numbers),
        ChannelRecipe(name=NAMES[1], unit="deg", switching=switching, **numbers),
    )
    return Recipe(mode="causal", tuned_on=recipes.Origin(rate_hz=RATE_HZ), channel=channels)


def output_of(first: int, rows: int) -> Output:
    """Return rows whose readings are their numbers, a thousandth of it beside an offset."""
    row = np.arange(first, first + rows, dtype=np.float64)
    values = np.column_stack([row, 1e6 + row / 1000])
    sigma, verdicts = np.full_like(values, 0.25), np.zeros(values.shape, np.int8)
    return Output(first, row / RATE_HZ, values, values, sigma, verdicts, modes=np.column_stack([row % 2, 1 - row % 2]))


@dataclass
class Asked:
    """A runner that makes and takes a recipe when it is told to: the newest, and those who asked before hear so."""

    meter: Meter
    waiting: list[tuple[Callable[[], Recipe], RetuneCallback]] = field(default_factory=list)
    making: tuple[Recipe, RetuneCallback] | None = None

    def retune(self, recipe: Callable[[], Recipe], heard: RetuneCallback) -> None:
        self.waiting.append((recipe, heard))

    def begin(self) -> None:
        """Make what was asked for last."""
        *older, (recipe, heard) = self.waiting
        self.waiting.clear()
        for _, told in older:
            told(None)
        self.making = recipe(), heard

    def take(self, why: str = "") -> Recipe:
        """Take what is made, or make what was asked for last and take it; or refuse it."""
        if self.making is None:
            self.begin()
        assert self.making is not None
        (recipe, heard), self.making = self.making, None
        if not why:
            self.meter.set_recipe(recipe.to_toml())
        heard(why)
        return recipe


@dataclass
class Shown:
    """A live page that is served."""

    page: LivePage
    meter: Meter
    asked: Asked
    access: Access
    rows: int = 0

    def begin(self) -> None:
        """Let the stream begin."""
        toml = recipe_of().to_toml()
        self.page.feed.open(Head(NAMES, ("m", "deg"), RATE_HZ, toml))
        self.meter.begin(NAMES, toml)
        self.meter.state("running")

    def push(self, rows: int) -> None:
        """Tell the next rows."""
        output = output_of(self.rows, rows)
        self.page.feed.write(output)
        self.meter.record(output)
        self.rows += rows

    @contextmanager
    def wire(self, link: socket.socket | None = None) -> Iterator[Wire]:
        """Look on."""
        base = f"http://{LOOPBACK}:{self.access.port}"
        cookie = [("Cookie", f"{self.access.cookie}={TOKEN}")]
        url = f"ws://{LOOPBACK}:{self.access.port}/wire"
        with connect(
            url,
            sock=link,
            origin=Origin(base),
            additional_headers=cookie,
            proxy=None,
            max_queue=1,
            close_timeout=0.1,  # what is unread at the end stays unread
        ) as connected:
            yield Wire(connected)


@dataclass
class Wire:
    """A page's end of the wire."""

    link: ClientConnection
    number: int = 0

    def say(self, **message: Any) -> int:
        """Say something; return its number."""
        self.number += 1
        self.link.send(json.dumps({**message, "number": self.number}))
        return self.number

    def frame(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return what comes next; arrays of what is text are none."""
        came = self.link.recv(PATIENCE_S)
        return unframed(came) if isinstance(came, bytes) else (json.loads(came), {})

    def hear(self, kind: str, **wanted: Any) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return the next of a kind that holds some values."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            assert time.monotonic() < deadline, f"no {kind} came"  # health comes for ever
            header, arrays = self.frame()
            if header["kind"] == kind and all(header.get(name) == value for name, value in wanted.items()):
                return header, arrays

    def rest(self) -> list[tuple[dict[str, Any], dict[str, NDArray[Any]]]]:
        """Return all that comes until the other end hangs up."""
        came = []
        with suppress(ConnectionClosed):
            while True:
                came.append(self.frame())
        return came

    def follow(self, bin: int | None = 0, level: int = 0) -> None:
        """Follow a stream that has begun."""
        self.hear("welcome")
        self.say(do="from", level=level, bin=bin)

    def bins(self, until: int) -> list[tuple[int, int, int]]:
        """Return first, count and gap of frames until a bin has come; what they hold is checked."""
        found: list[tuple[int, int, int]] = []
        while not found or found[-1][0] + found[-1][1] < until:
            header, arrays = self.hear("bins")
            check(header, arrays)
            found.append((header["first"], header["count"], header["gap"]))
        return found


def check(header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Check that bins hold the rows that they should."""
    each = EACH * 8 ** header["level"]
    number = np.arange(header["first"], header["first"] + header["count"])
    np.testing.assert_allclose(arrays["t"], number * each / RATE_HZ)
    for name, rows in (("raw_low", number * each), ("clean_high", (number + 1) * each - 1)):
        values = arrays[name].reshape(-1, header["channels"]) + np.array(header["offset"])
        np.testing.assert_allclose(values[:, 0], rows, rtol=1e-6)
        np.testing.assert_allclose(values[:, 1], 1e6 + rows / 1000, rtol=0, atol=1e-3)
    assert (arrays["sigma"] == 0.25).all()
    assert (arrays["probability"] == 1.0).all(), "the greatest of each"


@contextmanager
def shown() -> Iterator[Shown]:
    """Serve a live page."""
    listener = listen(LOOPBACK, 0)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SENT_BYTES)  # else the kernel holds megabytes, or does not
    access = Access(LOOPBACK, listener.getsockname()[1], TOKEN)
    meter = Meter("replay:drive.csv")
    asked = Asked(meter)
    warned: list[str] = []
    page = LivePage(Feed(warned.append), meter, asked.retune)
    with Server(listener, site(Page("", partial(converse, page), page.routes), access)):
        yield Shown(page, meter, asked, access)
        page.close()
    assert warned == []
