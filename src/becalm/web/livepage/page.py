"""The state of the live page that all viewers share. Timers in the server's thread update it."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, NamedTuple

from becalm.errors import BecalmError, UsageError
from becalm.installation import version
from becalm.live.running.retuning import Retune
from becalm.live.watching.meter import Meter
from becalm.live.watching.scrubber import Scrubber
from becalm.web.frames import text
from becalm.web.livepage.feed import Feed
from becalm.web.livepage.live_dial import NOT_BEGUN, LiveDial, describe_filters
from becalm.web.livepage.pictures import LivePictures

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.routing import BaseRoute

_HEALTH_S, _LOOK_S = 1.0, 0.1  # time between two status messages, and between two calls of a timer
_GOODBYE_S = 2.0  # how long `close` waits until the last bins are sent

_log = logging.getLogger(__name__)


class VersionedMessage(NamedTuple):
    """A message to all viewers; its number increases when the text changes, and each viewer then gets it again."""

    number: int
    text: str


class LivePage:
    """The live page of a stream, for all its viewers.

    Parameters
    ----------
    feed : Feed
        Sink that collects the rows.
    meter : Meter
        Counters of the stream.
    retune : callable
        Function that requests another recipe, as `Runner.retune` does.
    """

    def __init__(self, feed: Feed, meter: Meter, retune: Retune) -> None:
        self.feed = feed
        self.dial = LiveDial(lambda: meter.recipe, retune)
        self.pictures: LivePictures | None = None
        self.health, self.tuning = VersionedMessage(0, ""), VersionedMessage(-1, "")
        self.ending = False
        self._closing, self._next_status_s = False, 0.0
        self._meter, self._scrub = meter, Scrubber()
        self._run = secrets.token_hex(8)
        self._recipe: tuple[str, bool] | None = None  # recipe and `can_undo` that `tuning` describes
        self._viewers = 0
        self._timers: list[asyncio.Task[None]] = []

    @property
    def routes(self) -> list[BaseRoute]:
        """Return the routes of the page other than its WebSocket."""
        from starlette.routing import Route

        return [Route("/save/recipe", self._save)]

    @asynccontextmanager
    async def count_viewer(self) -> AsyncIterator[None]:
        """Count a viewer as long as the context lasts; timers run while there is at least one viewer."""
        self._viewers += 1
        try:
            if not self._timers:
                self._update_health()
                self._timers = [asyncio.create_task(_repeat(each)) for each in (self._update, self._describe)]
            yield
        finally:
            self._viewers -= 1
            if not self._viewers:
                for timer in self._timers:
                    timer.cancel()
                self._timers = []

    def close(self) -> None:
        """Send all viewers the last messages and disconnect them; wait for this two seconds at most."""
        self._closing = True
        until = time.monotonic() + _GOODBYE_S
        while self._viewers and time.monotonic() < until:
            time.sleep(0.01)

    def welcome(self) -> str | None:
        """Return the first message to a page, which describes the stream; None before the stream has begun."""
        stream = self.feed.stream
        if stream is None:
            return None
        if self.pictures is None:
            self.pictures = LivePictures(stream.bins, len(stream.head.names))
        levels = range(len(stream.bins.rows_each))
        return text(
            {
                "kind": "welcome",
                "version": version(),
                "run": self._run,
                "names": stream.head.names,
                "units": stream.head.units,
                "rate_hz": stream.head.rate_hz,
                "rows_each": stream.bins.rows_each,
                "kept": [stream.bins.kept for _ in levels],
                "oldest": [stream.bins.oldest(level) for level in levels],
                "newest": [stream.bins.newest(level) for level in levels],
                "modes": stream.modes,
            }
        )

    async def _update(self) -> None:
        """Update the status of the stream once a second, and at once when the page closes."""
        if self._closing or time.monotonic() >= self._next_status_s:
            self.ending = self._closing
            self._update_health()

    def _update_health(self) -> None:
        self._next_status_s = time.monotonic() + _HEALTH_S
        status = self._scrub.scrub_value(self._meter.status())
        self.health = VersionedMessage(self.health.number + 1, text({"kind": "health", **status}))

    async def _describe(self) -> None:
        """Describe the filters after a change, in a thread, because it may take some seconds."""
        stream, now = self.feed.stream, (self._meter.recipe, self.dial.can_undo)
        if stream is None or not self._meter.recipe or self._recipe == now:
            return
        recipe, can_undo = now
        description = {}
        try:
            description = await asyncio.to_thread(describe_filters, recipe, 1 / stream.head.rate_hz)
        except BecalmError:  # the recipe runs, but cannot be described
            pass
        except Exception:
            _log.exception("The filters of a live page could not be described.")
        if self._meter.recipe != recipe:  # changed meanwhile; the next call describes the new recipe
            return
        self._recipe = now
        message = text({"kind": "tuned", "recipe": recipe, "can_undo": can_undo, **description})
        self.tuning = VersionedMessage(self.tuning.number + 1, message)

    async def _save(self, request: Request) -> Response:
        from starlette.responses import Response

        from becalm.web.site import as_file

        if not self._meter.recipe:
            raise UsageError(NOT_BEGUN)
        return Response(self._meter.recipe, media_type="application/toml", headers=as_file("live.recipe.toml"))


async def _repeat(do: Callable[[], Awaitable[None]]) -> None:
    """Call a function every `_LOOK_S` seconds, even if it raises an exception, which is logged."""
    while True:
        await asyncio.sleep(_LOOK_S)
        try:
            await do()
        except Exception:
            _log.exception("The live page could not be updated.")
