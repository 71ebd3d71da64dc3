"""How long the tuner takes from a turn of its dial to the new picture, on ten million readings.

A server on loopback runs in a thread, and a client exchanges messages with it over a WebSocket, as a browser does. The
tables show the time from sending "turn" until the picture has arrived and is decoded; it has 2000 stretches. Each turn
goes to a new position, so that no result is cached, and the dial is dragged or released. If the gate rejected spikes in
the picture before, the first picture leaves out the same spikes; *judged* is the picture after the gate has run again.
"Whole" is all rows, "1 s" is one second in the middle. The record is a random walk in white noise at 10 kHz, in some
rows with a tone or with spikes.

The last table is measured in Chromium without a graphics card, with a recipe that becalm tuned: the time from the
dial's input event until the canvas is drawn; the screen shows it with its next frame.

Run: python benchmarks/app_speed.py [--rows 10000000] [--turns 15] [-o docs/app-speed.md]
"""

from __future__ import annotations

import json
import socket
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from app_browser import in_browser
from becalm.cleaning.recipes.recipe import ChannelRecipe, Recipe
from becalm.cleaning.recipes.recipe import Origin as TunedOn
from becalm.cleaning.recipes.recipe_parts import GateRecipe, ToneRecipe
from becalm.web.access import LOOPBACK, Access
from becalm.web.frames import unframed
from becalm.web.serving import Server, listen
from becalm.web.site import Page, site
from becalm.web.tuner import Tuner
from pages import page_parser, publish

RATE_HZ = 10_000.0
MOST_WHOLE_MS, MOST_NEAR_MS = 150.0, 50.0
"""Required times for a picture of ten million rows, and of one second of them."""

_WIDTH, _PATIENCE_S = 2000, 600.0
_TOKEN = "a-token-for-a-benchmark-on-loopback"


class Kind(NamedTuple):
    """A kind of filter."""

    name: str
    channel: str
    order: int
    mode: str = "smoothed"
    lag_s: float | None = None
    gate: bool = False
    tone: bool = False

    def recipe(self) -> Recipe:
        """Return the recipe of the filter, which a page can restore."""
        tone = ToneRecipe(frequency_hz=50.0, bandwidth_hz=0.5, process_noise_density=0.01)
        channel = ChannelRecipe(
            name=self.channel,
            model="motion",
            order=self.order,
            process_noise_density=1.0,
            noise_std=1.0,
            gate=GateRecipe() if self.gate else None,
            tone=(tone,) if self.tone else (),
        )
        fields = {"mode": self.mode, "lag_s": self.lag_s, "tuned_on": TunedOn(rate_hz=RATE_HZ), "channel": (channel,)}
        return Recipe.model_validate(fields)


KINDS = (
    *(Kind(f"smoothed, order {order}", "plain", order) for order in (1, 2, 3)),
    *(Kind(f"causal, order {order}", "plain", order, "causal") for order in (1, 2, 3)),
    Kind("told 10 ms later, order 2", "plain", 2, "lagged", 0.01),
    Kind("smoothed, order 1, with a gate and spikes", "spiky", 1, gate=True),
    Kind("smoothed, order 2, with a gate and no spikes", "plain", 2, gate=True),
    Kind("causal, order 1, with a tone", "toned", 1, "causal", tone=True),
    Kind("smoothed, order 1, with a tone", "toned", 1, tone=True),
)


def make(path: Path, rows: int) -> None:
    """Write the records."""
    rng = np.random.default_rng(1)
    plain = np.cumsum(rng.normal(size=rows)) * 0.01 + rng.normal(size=rows)
    spiky = plain.copy()
    spiky[rng.integers(0, rows, rows // 20_000)] += 50.0
    toned = plain + np.sin(2 * np.pi * 50.0 / RATE_HZ * np.arange(rows))
    times = np.arange(rows) / RATE_HZ
    pq.write_table(pa.table({"time_s": times, "plain": plain, "spiky": spiky, "toned": toned}), path)


class Link:
    """A client of the tuner that measures times."""

    def __init__(self, wire: ClientConnection) -> None:
        self._wire, self._number = wire, 0

    def ask(self, do: str, **more: Any) -> int:
        """Send a message; return its number."""
        self._number += 1
        self._wire.send(json.dumps({"number": self._number, "do": do, **more}))
        return self._number

    def until(self, kind: str, answers: int = 0) -> dict[str, Any]:
        """Wait for a message of a kind that answers the message with number `answers`, or a later one."""
        while True:
            data = self._wire.recv(_PATIENCE_S)
            message = json.loads(data) if isinstance(data, str) else unframed(data)[0]
            if message["kind"] == "trouble":
                raise SystemExit(message["says"])
            if message["kind"] == kind and (message.get("answers") or 0) >= answers:
                return message

    def turned_ms(self, channel: int, density: float, final: bool) -> tuple[float, float]:
        """Turn the dial; return the times of the first picture and of the picture after the gate has run again."""
        begun = time.perf_counter()
        number = self.ask("turn", channel=channel, settings={"process_noise_density": density}, final=final)
        first = self.until("picture", number)
        first_ms = 1e3 * (time.perf_counter() - begun)
        if not (final and first["hurried"]):
            return first_ms, first_ms
        self.until("picture", number)
        return first_ms, 1e3 * (time.perf_counter() - begun)


@contextmanager
def linked(folder: Path) -> Iterator[Link]:
    """Serve the tuner, and connect a client to it."""
    listener = listen(LOOPBACK, 0)
    access, tuner = Access(LOOPBACK, listener.getsockname()[1], _TOKEN), Tuner(folder, None, 1)
    base = f"http://{LOOPBACK}:{access.port}"
    try:
        with (
            Server(listener, site(Page("", tuner.wire, tuner.routes), access)),
            connect(
                f"ws://{LOOPBACK}:{access.port}/wire",
                origin=Origin(base),
                additional_headers=[("Cookie", f"{access.cookie}={_TOKEN}")],
                sock=socket.create_connection((LOOPBACK, access.port)),
                max_size=None,
                proxy=None,
            ) as wire,
        ):
            yield Link(wire)
    finally:
        tuner.close()


def measured(link: Link, channel: int, turns: int, span_s: tuple[float, float] | None, final: bool) -> str:
    """Measure some turns, after one that does not count; return their times for the table."""
    from_s, to_s = span_s or (None, None)
    link.until("picture", link.ask("look", channel=channel, from_s=from_s, to_s=to_s, width=_WIDTH))
    densities = np.geomspace(0.3, 3.0, turns + 1)
    first, whole = zip(*[link.turned_ms(channel, float(density), final) for density in densities][1:], strict=True)
    return _summary(first) if first == whole else f"{_summary(first)}, judged {_summary(whole)}"


def _summary(took_ms: Sequence[float]) -> str:
    return f"{median(took_ms):.0f} ({max(took_ms):.0f})"


def table(rows: int, turns: int) -> str:
    """Measure, and return the table."""
    lines = [
        f"{rows:,} rows at {RATE_HZ:g} Hz, {turns} turns each; the median, and in brackets the longest. Asked: at most"
        f" {MOST_WHOLE_MS:g} ms whole, and {MOST_NEAR_MS:g} ms of 1 s.",
        "",
        "| filter | whole, dragged, ms | whole, let go, ms | 1 s, ms |",
        "|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as name:
        make(Path(name) / "record.parquet", rows)
        with linked(Path(name)) as link:
            link.ask("open", file="folder/record.parquet")
            names = [channel["name"] for channel in link.until("recording")["channels"]]
            middle_s = rows / RATE_HZ / 2
            for kind in KINDS:
                link.until("picture", link.ask("restore", recipe=kind.recipe().to_toml()))
                channel = names.index(kind.channel)
                near = (middle_s, middle_s + 1.0)
                looks = ((None, False), (None, True), (near, False))
                cells = " | ".join(measured(link, channel, turns, *look) for look in looks)
                lines.append(f"| {kind.name} | {cells} |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Print the table; with -o, write it as a page."""
    parser = page_parser(__doc__)
    parser.add_argument("--rows", type=int, default=10_000_000, help="how long")
    parser.add_argument("--turns", type=int, default=15, help="of the dial, for each picture")
    arguments = parser.parse_args()
    text = f"{table(arguments.rows, arguments.turns)}\n{in_browser(arguments.rows, arguments.turns)}"
    publish("How fast the tuner's picture follows its dial", __doc__, text, arguments.output)


if __name__ == "__main__":
    main()
