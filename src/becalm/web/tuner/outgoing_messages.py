"""Send messages to a page, one after the other; report the requests of the page that failed."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from starlette.websockets import WebSocket, WebSocketDisconnect

from becalm.errors import BecalmError
from becalm.web.frames import UNFORESEEN, text

_log = logging.getLogger(__name__)

Payload = TypeVar("Payload", str, bytes)


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

    async def send_error(self, says: str, answers: int | None) -> None:
        """Send a sentence on an error, with the number of the message that caused it."""
        await self.send_message({"kind": "trouble", "says": says, "answers": answers})

    async def report_errors(self, work: Callable[[], Awaitable[None]], number: int | None) -> None:
        """Await some work for a page; if it fails, send the page the error."""
        try:
            await work()
        except WebSocketDisconnect:
            raise
        except BecalmError as cause:
            await self.send_error(str(cause), number)
        except Exception:  # the connection stays open
            if not self.gone:
                _log.exception("A page's request failed.")
                await self.send_error(UNFORESEEN, number)

    async def _transmit(self, send: Callable[[Payload], Awaitable[None]], data: Payload) -> None:
        async with self._sending:
            if self.gone:
                raise WebSocketDisconnect
            try:
                await send(data)
            except WebSocketDisconnect:
                self.gone = True
                raise
