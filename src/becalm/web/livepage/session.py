"""The session of one viewer: it sends bins as they close, at the pace of the screen, and answers requests."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from becalm.errors import BecalmError
from becalm.web.frames import text
from becalm.web.incoming_messages import heard, number_of
from becalm.web.livepage.live_dial import NOT_BEGUN
from becalm.web.livepage.messages import MOST_BINS, From, Message, Past, TuneRequest, understood
from becalm.web.livepage.page import LivePage

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

UPDATES_PER_S = 30
_MOST_ANSWERS = 16  # that wait, or are waited for, before no more is heard
_MOST_HEARD = 8  # between two updates: a hand says less, and others look on too
_NORMAL = 1000  # how a WebSocket is told that all was said


class Viewer:
    """The conversation with one page, which has a cursor of its own.

    Parameters
    ----------
    page : LivePage
        What it looks at.
    websocket : WebSocket
        Accepted already.
    """

    def __init__(self, page: LivePage, websocket: WebSocket) -> None:
        self._page, self._websocket = page, websocket
        self._answers: deque[Callable[[], str | bytes]] = deque()
        self._tunings = 0  # that filters have not taken yet
        self._heard = 0  # since the last update
        self._level = 0
        self._next: int | None = None  # bin to send; None until the page says which
        self._welcomed = False
        self._told_tuning = self._told_health = -1

    async def converse(self) -> None:
        """Speak until the page hangs up, or the stream has ended and all of it is told."""
        tasks = [asyncio.create_task(each) for each in (self._hear_all(), self._tell_all())]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:  # also where this one is cancelled, for the page may see no more
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        for task in done:
            task.result()

    async def _hear_all(self) -> None:
        while True:
            frame = await self._websocket.receive()
            if frame["type"] == "websocket.disconnect":
                return
            self._heard += 1
            while self._heard > _MOST_HEARD or len(self._answers) + self._tunings >= _MOST_ANSWERS:
                await asyncio.sleep(1 / UPDATES_PER_S)
            number = None
            try:
                said = heard(frame)
                number = number_of(said)
                self._do(understood(said))
            except BecalmError as cause:
                self._trouble(str(cause), number)

    def _do(self, message: Message) -> None:
        if isinstance(message, From):
            self._level, self._next = message.level, message.bin
            if message.bin is None and self._page.feed.shown is not None:
                self._next = self._page.feed.shown.bins.newest(message.level)
        elif isinstance(message, Past):
            self._answers.append(lambda: self._past(message))
        else:
            self._tune(message)

    def _tune(self, message: Message) -> None:
        loop, number = asyncio.get_running_loop(), message.number

        def told(why: str | None) -> None:  # by the thread that filters
            try:
                loop.call_soon_threadsafe(self._tuned, why, number)
            except RuntimeError:  # the server has ended meanwhile
                return

        if isinstance(message, TuneRequest):
            self._page.desk.turn(message.channel, message.process_noise_density, message.noise_std, told)
        else:
            self._page.desk.undo(told)
        self._tunings += 1

    def _tuned(self, why: str | None, number: int) -> None:
        self._tunings -= 1
        if why:
            self._trouble(why, number)
        else:
            kind = "passed over" if why is None else "taken"
            self._answers.append(lambda: text({"kind": kind, "answers": number}))

    def _trouble(self, says: str, answers: int | None) -> None:
        said = text({"kind": "trouble", "says": says, "answers": answers})
        self._answers.append(lambda: said)

    def _past(self, message: Past) -> str | bytes:
        pictures = self._page.pictures
        if pictures is None:
            return text({"kind": "trouble", "says": NOT_BEGUN, "answers": message.number})
        return pictures.past(message.level, message.first, message.count, message.number)

    async def _tell_all(self) -> None:
        """Say what is new, 30 times a second of absolute time; what is said slowly is said less often, and whole."""
        loop = asyncio.get_running_loop()
        while True:
            self._heard = 0
            ending = self._page.ending  # before what is new: it is the last then
            for each in self._news():
                await self._say(each)
            if ending:
                await self._websocket.close(_NORMAL, "The stream has ended.")
                return
            await asyncio.sleep((loop.time() * UPDATES_PER_S // 1 + 1) / UPDATES_PER_S - loop.time())

    async def _say(self, said: str | bytes) -> None:
        if isinstance(said, bytes):
            await self._websocket.send_bytes(said)
        else:
            await self._websocket.send_text(said)

    def _news(self) -> list[str | bytes]:
        """Return what this page has not heard."""
        page, news = self._page, list[str | bytes]()
        if not self._welcomed and (welcome := page.welcome()) is not None:
            self._welcomed = True
            news.append(welcome)
        if self._welcomed and page.tuning.number != self._told_tuning:
            self._told_tuning = page.tuning.number
            news.append(page.tuning.told)
        if page.health.number != self._told_health:
            self._told_health = page.health.number
            news.append(page.health.told)
        while self._answers:
            news.append(self._answers.popleft()())
        if self._next is not None and page.pictures is not None:
            found = page.pictures.following(self._level, self._next, MOST_BINS)
            if found is not None:
                self._next, picture = found
                news.append(picture)
        return news


async def converse(page: LivePage, websocket: WebSocket) -> None:
    """Speak with one who looks on until it hangs up."""
    await websocket.accept()
    async with page.looked_at():
        await Viewer(page, websocket).converse()
