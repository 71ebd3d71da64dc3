"""Send messages to a page one after the other, and a sentence where something could not be done."""

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
    """The way down to one page.

    Parameters
    ----------
    websocket : WebSocket
        That it is spoken to by.

    Attributes
    ----------
    gone : bool
        Whether the page was closed, as whoever speaks to it then hears by a WebSocketDisconnect.
    """

    def __init__(self, websocket: WebSocket) -> None:
        self._websocket, self._sending = websocket, asyncio.Lock()
        self.gone = False

    async def tell(self, message: dict[str, Any]) -> None:
        """Send a message."""
        await self._say(self._websocket.send_text, text(message))

    async def send(self, data: bytes) -> None:
        """Send a frame."""
        await self._say(self._websocket.send_bytes, data)

    async def trouble(self, says: str, answers: int | None) -> None:
        """Say what could not be done, and which message asked for it."""
        await self.tell({"kind": "trouble", "says": says, "answers": answers})

    async def guarded(self, doing: Callable[[], Awaitable[None]], number: int | None) -> None:
        """Do something, and tell the page in a sentence where it cannot be done."""
        try:
            await doing()
        except WebSocketDisconnect:
            raise
        except BecalmError as cause:
            await self.trouble(str(cause), number)
        except Exception:  # the page goes on, and whoever runs becalm is told
            if not self.gone:
                _log.exception("What a page asked for failed.")
                await self.trouble(UNFORESEEN, number)

    async def _say(self, send: Callable[[Said], Awaitable[None]], said: Said) -> None:
        async with self._sending:
            if self.gone:
                raise WebSocketDisconnect
            try:
                await send(said)
            except WebSocketDisconnect:
                self.gone = True
                raise
