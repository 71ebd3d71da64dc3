"""What goes down to a page: one message after the other, and a sentence where something could not be done."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from becalm.errors import BecalmError
from becalm.web.frames import UNFORESEEN, text

_log = logging.getLogger(__name__)


class Wire:
    """The way down to one page.

    Parameters
    ----------
    websocket : WebSocket
        That it is spoken to by.

    Attributes
    ----------
    gone : bool
        Whether the page was closed.
    """

    def __init__(self, websocket: WebSocket) -> None:
        self._websocket, self._sending = websocket, asyncio.Lock()
        self.gone = False

    async def tell(self, message: dict[str, Any]) -> None:
        """Send a message."""
        async with self._sending:
            await self._websocket.send_text(text(message))

    async def send(self, data: bytes) -> None:
        """Send a frame."""
        async with self._sending:
            await self._websocket.send_bytes(data)

    async def trouble(self, says: str, answers: int | None) -> None:
        """Say what could not be done, and which message asked for it, unless the page is gone."""
        try:
            await self.tell({"kind": "trouble", "says": says, "answers": answers})
        except WebSocketDisconnect:
            self.gone = True

    async def guarded(self, doing: Awaitable[None], number: int | None) -> None:
        """Do something, and tell the page in a sentence where it cannot be done."""
        try:
            await doing
        except WebSocketDisconnect:  # whoever hears the page is told so too, and ends the conversation
            self.gone = True
        except BecalmError as cause:
            await self.trouble(str(cause), number)
        except Exception:  # the page goes on, and whoever runs becalm is told
            if not self.gone:
                _log.exception("What a page asked for failed.")
                await self.trouble(UNFORESEEN, number)
