"""The session of one viewer of a live page: it sends bins as they close, 30 times a second, and answers requests."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from becalm.errors import BecalmError
from becalm.web.frames import text
from becalm.web.incoming_messages import number_of, parse_frame
from becalm.web.livepage.live_dial import NOT_BEGUN
from becalm.web.livepage.messages import MOST_BINS, From, Message, Past, TuneRequest, parse_message
from becalm.web.livepage.page import LivePage

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

UPDATES_PER_S = 30
_MOST_ANSWERS = 16  # limit of unsent or unfinished answers; no message is read until there are fewer
_MOST_MESSAGES = 8  # limit of messages between two updates: other viewers need time too, and a person causes fewer
_NORMAL = 1000  # close code of a WebSocket


class Viewer:
    """The session of one viewer, with its own position in the stream.

    Parameters
    ----------
    page : LivePage
        Page, common to all viewers.
    websocket : WebSocket
        Connection, accepted already.
    """

    def __init__(self, page: LivePage, websocket: WebSocket) -> None:
        self._page, self._websocket = page, websocket
        self._answers: deque[Callable[[], str | bytes]] = deque()
        self._tunings = 0  # number of requested changes without an answer
        self._received = 0  # number of messages since the last update
        self._level = 0
        self._next: int | None = None  # number of the next bin to send; None until the page has chosen one
        self._welcomed = False
        self._sent_tuning = self._sent_health = -1  # numbers of the last messages of their kind

    async def converse(self) -> None:
        """Exchange messages until the page disconnects, or until the stream has ended and all its bins are sent."""
        tasks = [asyncio.create_task(each) for each in (self._receive_all(), self._send_all())]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:  # also after a cancellation: the page must not get any more data
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        for task in done:
            task.result()

    async def _receive_all(self) -> None:
        while True:
            frame = await self._websocket.receive()
            if frame["type"] == "websocket.disconnect":
                return
            self._received += 1
            while self._received > _MOST_MESSAGES or len(self._answers) + self._tunings >= _MOST_ANSWERS:
                await asyncio.sleep(1 / UPDATES_PER_S)
            number = None
            try:
                content = parse_frame(frame)
                number = number_of(content)
                self._do(parse_message(content))
            except BecalmError as cause:
                self._answer_error(str(cause), number)

    def _do(self, message: Message) -> None:
        if isinstance(message, From):
            self._level, self._next = message.level, message.bin
            if message.bin is None and self._page.feed.stream is not None:
                self._next = self._page.feed.stream.bins.newest(message.level)
        elif isinstance(message, Past):
            self._answers.append(lambda: self._past(message))
        else:
            self._tune(message)

    def _tune(self, message: Message) -> None:
        loop, number = asyncio.get_running_loop(), message.number

        def settled(why: str | None) -> None:  # called by the filtering thread
            try:
                loop.call_soon_threadsafe(self._tuned, why, number)
            except RuntimeError:  # the server has ended
                return

        if isinstance(message, TuneRequest):
            self._page.dial.turn(message.channel, message.process_noise_density, message.noise_std, settled)
        else:
            self._page.dial.undo(settled)
        self._tunings += 1

    def _tuned(self, why: str | None, number: int) -> None:
        self._tunings -= 1
        if why:
            self._answer_error(why, number)
        else:
            kind = "passed over" if why is None else "taken"
            self._answers.append(lambda: text({"kind": kind, "answers": number}))

    def _answer_error(self, says: str, answers: int | None) -> None:
        message = text({"kind": "trouble", "says": says, "answers": answers})
        self._answers.append(lambda: message)

    def _past(self, message: Past) -> str | bytes:
        pictures = self._page.pictures
        if pictures is None:
            return text({"kind": "trouble", "says": NOT_BEGUN, "answers": message.number})
        return pictures.past(message.level, message.first, message.count, message.number)

    async def _send_all(self) -> None:
        """Send updates 30 times a second, or less often over a slow connection; no update is lost."""
        loop = asyncio.get_running_loop()
        while True:
            self._received = 0
            ending = self._page.ending  # read first: if it is set, the following updates are the last ones
            for each in self._updates():
                await self._send(each)
            if ending:
                await self._websocket.close(_NORMAL, "The stream has ended.")
                return
            await asyncio.sleep((loop.time() * UPDATES_PER_S // 1 + 1) / UPDATES_PER_S - loop.time())

    async def _send(self, message: str | bytes) -> None:
        if isinstance(message, bytes):
            await self._websocket.send_bytes(message)
        else:
            await self._websocket.send_text(message)

    def _updates(self) -> list[str | bytes]:
        """Return the messages that this page does not have yet."""
        page, updates = self._page, list[str | bytes]()
        if not self._welcomed and (welcome := page.welcome()) is not None:
            self._welcomed = True
            updates.append(welcome)
        if self._welcomed and page.tuning.number != self._sent_tuning:
            self._sent_tuning = page.tuning.number
            updates.append(page.tuning.text)
        if page.health.number != self._sent_health:
            self._sent_health = page.health.number
            updates.append(page.health.text)
        while self._answers:
            updates.append(self._answers.popleft()())
        if self._next is not None and page.pictures is not None:
            following = page.pictures.following(self._level, self._next, MOST_BINS)
            if following is not None:
                self._next, picture = following
                updates.append(picture)
        return updates


async def converse(page: LivePage, websocket: WebSocket) -> None:
    """Accept a WebSocket, and serve this viewer until it disconnects or the stream has ended."""
    await websocket.accept()
    async with page.count_viewer():
        await Viewer(page, websocket).converse()
