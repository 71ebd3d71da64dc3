"""Send messages to a page, one after the other, and report requests that failed."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from starlette.websockets import WebSocket, WebSocketDisconnect

from becalm.errors import BecalmError
from becalm.web.frames import UNFORESEEN, text

_log = logging.getLogger(__name__)

Said = TypeVar("Said", str, bytes)


class Wire:
    """The sending side of the connection to one page.

    Parameters
    ----------
    websocket : WebSocket
        Connection to the page.

    Attributes
    ----------
    gone : bool
        Whether the page is closed; sending then raises a WebSocketDisconnect.
    """

    def __init__(self, websocket: WebSocket) -> None:
        self._websocket, self._sending = websocket, asyncio.Lock()
        self.gone = False

    async def send_message(self, message: dict[str, Any]) -> None:
        """Send a message as JSON."""
        await self._transmit(self._websocket.send_text, text(message))

    async def send_frame(self, data: bytes) -> None:
        """Send a binary frame."""
        await self._transmit(self._websocket.send_bytes, data)

    async def trouble(self, says: str, answers: int | None) -> None:
        """Send a sentence on an error, with the number of the message that caused it."""
        await self.send_message({"kind": "trouble", "says": says, "answers": answers})

    async def guarded(self, doing: Callable[[], Awaitable[None]], number: int | None) -> None:
        """Await some work; if it fails, report the error to the page."""
        try:
            await doing()
        except WebSocketDisconnect:
            raise
        except BecalmError as cause:
            await self.trouble(str(cause), number)
        except Exception:  # the page goes on
            if not self.gone:
                _log.exception("A page's request failed.")
                await self.trouble(UNFORESEEN, number)

    async def _transmit(self, send: Callable[[Said], Awaitable[None]], data: Said) -> None:
        async with self._sending:
            if self.gone:
                raise WebSocketDisconnect
            try:
                await send(data)
            except WebSocketDisconnect:
                self.gone = True
                raise
