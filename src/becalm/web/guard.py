"""Refuse requests to a page that use a foreign host name, come from a foreign page or lack the token."""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from typing import TYPE_CHECKING
from urllib.parse import parse_qs

from becalm.web.access import Access, TicketReusedError

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

MOST_VIEWERS = 32  # limit of open WebSockets
_OWN_SITE = ("same-origin", "none")  # values of Sec-Fetch-Site; none: a person typed the address
_TRY_AGAIN_LATER = 1013  # close code of a WebSocket
_BROKEN = 1011  # close code of a WebSocket
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
    """ASGI middleware that checks every request, HTTP and WebSocket, before the application gets it.

    Parameters
    ----------
    app : ASGI application
        Application to protect.
    access : Access
        Names and token of the page.
    """

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access
        self._viewers = 0
        self._answering: set[asyncio.Task[object]] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, refuse it or pass it on; exceptions of the application are logged, not raised."""
        request = _Request(scope)

        async def secured(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                others = [pair for pair in message.get("headers", ()) if pair[0].lower() not in _SECURITY]
                message = {**message, "headers": [*others, *_SECURITY.items()]}
            try:
                await send(message)
            except RuntimeError as cause:  # uvicorn raises it for a closed WebSocket, where ASGI wants an OSError
                if message["type"] != "websocket.send":
                    raise
                raise ConnectionError("The page is gone.") from cause

        if (why := self._foreign(request)) is not None:
            await _answer(request, secured, 403, why)
        elif request.header(b"content-length") is not None and request.header(b"transfer-encoding") is not None:
            # servers may disagree on where such a request ends (request smuggling)
            await _answer(request, secured, 400, "This request gives its length in two ways.")
        elif request.is_login:
            await self._log_in(request, secured)
        elif not any(map(self._access.is_token, request.cookies(self._access.cookie))):
            why = "Open the address that becalm printed: it contains the token of this page."
            await _answer(request, secured, 403, why)
        else:
            await self._pass_on(scope, receive, secured)

    def _foreign(self, request: _Request) -> str | None:
        """Return a sentence on why a request is foreign, or None if it comes from this page."""
        host, origin, site = request.header(b"host"), request.header(b"origin"), request.header(b"sec-fetch-site")
        if host is None or not self._access.is_own_host(host):
            return "The host name of this request is not one of the page's; open the address that becalm printed."
        if origin is None and request.is_websocket:
            return "Only a page of becalm may connect here, and it sends its origin."
        if origin is not None and not self._access.same_origin(origin, host):
            return "Another page sent this request; only a page of becalm may."
        if site is not None and site not in _OWN_SITE:
            return "Another page links here; copy the address that becalm printed into the browser's address line."
        return None

    async def _log_in(self, request: _Request, send: Send) -> None:
        """Set the cookie of a browser that sends the token, and redirect it to an address without the token."""
        why = "The token in this address is not that of the page; open the address that becalm printed last."
        try:
            admitted = self._access.admits(request.token)
        except TicketReusedError as cause:
            admitted, why = False, str(cause)
            self._end_all(why)
        if not admitted:
            await _answer(request, send, 403, why)
            return
        headers = [(b"location", b"/"), (b"set-cookie", self._access.set_cookie().encode("ascii"))]
        await _answer(request, send, 303, "", headers)

    def _end_all(self, why: str) -> None:
        """Cancel all requests that are being answered, and log why."""
        for task in self._answering:
            task.cancel()
        _log.warning(why)

    async def _pass_on(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket" and self._viewers >= MOST_VIEWERS:
            await send({"type": "websocket.accept"})
            why = f"{MOST_VIEWERS} pages are connected already; close one of them."
            await send({"type": "websocket.close", "code": _TRY_AGAIN_LATER, "reason": why})
            return
        is_viewer = scope["type"] == "websocket"
        self._viewers += is_viewer
        task = asyncio.current_task()
        assert task is not None
        self._answering.add(task)
        try:
            await self._app(scope, receive, send)
        except Exception as cause:  # other requests continue
            _log.exception("A page's request failed.", exc_info=cause)
            if is_viewer:
                with suppress(Exception):  # the WebSocket may be closed already
                    await send({"type": "websocket.close", "code": _BROKEN, "reason": "Something went wrong."})
        finally:
            self._answering.discard(task)
            self._viewers -= is_viewer


class _Request:
    """The headers and the token of a request."""

    def __init__(self, scope: Scope) -> None:
        self.is_websocket = scope["type"] == "websocket"
        self._headers: list[tuple[bytes, bytes]] = scope["headers"]
        opens = not self.is_websocket and scope["method"] in ("GET", "HEAD") and scope["path"] == "/"
        query: str = scope["query_string"].decode("latin-1") if opens else ""
        self._tokens = parse_qs(query).get("token", [])

    @property
    def is_login(self) -> bool:
        return bool(self._tokens)

    @property
    def token(self) -> str:
        return self._tokens[0]

    def header(self, name: bytes) -> str | None:
        """Return the value of a header, or None; "" (never valid) if it occurs twice, because no browser does that."""
        values = [value for key, value in self._headers if key == name]
        return None if not values else values[0].decode("latin-1") if len(values) == 1 else ""

    def cookies(self, name: str) -> list[str]:
        """Return the values of all cookies with this name; other ports of this machine may have set some too."""
        joined = "; ".join(value.decode("latin-1") for key, value in self._headers if key == b"cookie")
        pairs = (part.strip().partition("=") for part in joined.split(";"))
        return [value for key, _, value in pairs if key == name]


async def _answer(
    request: _Request, send: Send, status: int, says: str, headers: list[tuple[bytes, bytes]] | None = None
) -> None:
    """Answer with a sentence and close the connection, so that the rest of the request's body is not read."""
    kind = "websocket.http.response" if request.is_websocket else "http.response"
    body = says.encode()
    own = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
    ]
    await send({"type": f"{kind}.start", "status": status, "headers": own + (headers or [])})
    await send({"type": f"{kind}.body", "body": body})
