"""The door of a page: what comes by a foreign name, from a foreign page or without the token gets no further."""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from typing import TYPE_CHECKING
from urllib.parse import parse_qs

from becalm.web.access import Access, StolenError

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

MOST_VIEWERS = 32
_OWN_SITE = ("same-origin", "none")  # none: a person typed the address
_TRY_AGAIN_LATER = 1013  # how a WebSocket is told so
_BROKEN = 1011
_SECURITY = {
    b"content-security-policy": b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:;"
    b" connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    b"x-content-type-options": b"nosniff",
    b"referrer-policy": b"no-referrer",
    b"cache-control": b"no-store",
    b"cross-origin-opener-policy": b"same-origin",
    b"cross-origin-resource-policy": b"same-origin",
}
_log = logging.getLogger("becalm.web")


class Guard:
    """Stands before an application, for HTTP and WebSocket alike.

    Parameters
    ----------
    app : ASGI application
        What is behind the door.
    access : Access
        Who may come in.
    """

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access
        self._viewers = 0
        self._answering: set[asyncio.Task[object]] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, refuse or pass on what came; nothing is raised."""
        asked = _Asked(scope)

        async def secured(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                others = [pair for pair in message.get("headers", ()) if pair[0].lower() not in _SECURITY]
                message = {**message, "headers": [*others, *_SECURITY.items()]}
            try:
                await send(message)
            except RuntimeError as cause:  # of uvicorn, where the WebSocket is closed already; ASGI has an OSError
                if message["type"] != "websocket.send":
                    raise
                raise ConnectionError("The page is gone.") from cause

        if (why := self._foreign(asked)) is not None:
            await _answer(asked, secured, 403, why)
        elif asked.header(b"content-length") is not None and asked.header(b"transfer-encoding") is not None:
            await _answer(asked, secured, 400, "Where this request ends is said in two ways.")  # to smuggle another in
        elif asked.is_login:
            await self._log_in(asked, secured)
        elif not any(map(self._access.knows, asked.cookies(self._access.cookie))):
            await _answer(asked, secured, 403, "Open the address that becalm printed: it holds the token of this page.")
        else:
            await self._pass_on(scope, receive, secured)

    def _foreign(self, asked: _Asked) -> str | None:
        """Return why something comes from elsewhere, None if from here."""
        host, origin, site = asked.header(b"host"), asked.header(b"origin"), asked.header(b"sec-fetch-site")
        if host is None or not self._access.ours(host):
            return "This page was asked for by a name that is not its own; open the address that becalm printed."
        if origin is None and asked.is_websocket:
            return "Only a page of becalm may speak here, and it says its origin."
        if origin is not None and not self._access.same_origin(origin, host):
            return "Another page asks for this; only a page of becalm may."
        if site is not None and site not in _OWN_SITE:
            return "Another page leads here; copy the address that becalm printed into the browser's address line."
        return None

    async def _log_in(self, asked: _Asked, send: Send) -> None:
        """Leave the token with a browser that brings it, and take it out of its address line."""
        why = "The token in this address is not that of the page; open the address that becalm printed last."
        try:
            admitted = self._access.admits(asked.token)
        except StolenError as cause:
            admitted, why = False, str(cause)
            self._end_all(why)
        if not admitted:
            await _answer(asked, send, 403, why)
            return
        headers = [(b"location", b"/"), (b"set-cookie", self._access.set_cookie().encode("ascii"))]
        await _answer(asked, send, 303, "", headers)

    def _end_all(self, why: str) -> None:
        """Leave who was let in before, and tell whoever runs becalm."""
        for task in self._answering:
            task.cancel()
        _log.warning(why)

    async def _pass_on(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket" and self._viewers >= MOST_VIEWERS:
            await send({"type": "websocket.accept"})
            why = f"{MOST_VIEWERS} pages look on already; close one of them."
            await send({"type": "websocket.close", "code": _TRY_AGAIN_LATER, "reason": why})
            return
        is_viewer = scope["type"] == "websocket"
        self._viewers += is_viewer
        task = asyncio.current_task()
        assert task is not None
        self._answering.add(task)
        try:
            await self._app(scope, receive, send)
        except Exception as cause:  # the page goes on for others, and whoever runs it is told
            _log.exception("A page's request failed.", exc_info=cause)
            if is_viewer:
                with suppress(Exception):  # it may be gone, or closed
                    await send({"type": "websocket.close", "code": _BROKEN, "reason": "Something went wrong."})
        finally:
            self._answering.discard(task)
            self._viewers -= is_viewer


class _Asked:
    """What a request says of itself."""

    def __init__(self, scope: Scope) -> None:
        self.is_websocket = scope["type"] == "websocket"
        self._headers: list[tuple[bytes, bytes]] = scope["headers"]
        opens = not self.is_websocket and scope["method"] in ("GET", "HEAD") and scope["path"] == "/"
        said: str = scope["query_string"].decode("latin-1") if opens else ""
        self._tokens = parse_qs(said).get("token", [])

    @property
    def is_login(self) -> bool:
        return bool(self._tokens)

    @property
    def token(self) -> str:
        return self._tokens[0]

    def header(self, name: bytes) -> str | None:
        """Return a header; what is there twice is no header of a browser, and is nobody's name."""
        found = [value for key, value in self._headers if key == name]
        return None if not found else found[0].decode("latin-1") if len(found) == 1 else ""

    def cookies(self, name: str) -> list[str]:
        """Return the cookies of a name: sites on other ports of this machine leave theirs as well."""
        written = "; ".join(value.decode("latin-1") for key, value in self._headers if key == b"cookie")
        pairs = (part.strip().partition("=") for part in written.split(";"))
        return [value for key, _, value in pairs if key == name]


async def _answer(
    asked: _Asked, send: Send, status: int, says: str, headers: list[tuple[bytes, bytes]] | None = None
) -> None:
    """Answer in words, and hang up: a body that is still on its way shall not be waited for."""
    kind = "websocket.http.response" if asked.is_websocket else "http.response"
    body = says.encode()
    own = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
    ]
    await send({"type": f"{kind}.start", "status": status, "headers": own + (headers or [])})
    await send({"type": f"{kind}.body", "body": body})
