"""A page on a real server of loopback, and ways to ask it as no browser would."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import httpx
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route
from starlette.websockets import WebSocket
from websockets.sync.client import ClientConnection, connect

from becalm.errors import BecalmError
from becalm.web.access import LOOPBACK, Access
from becalm.web.frames import text
from becalm.web.incoming_messages import parse_frame
from becalm.web.serving import Server, listen
from becalm.web.site import Page, site
from becalm.web.uploads import Uploads

PATIENCE_S = 30.0
TOKEN = "a-token-that-is-long-enough-for-all"
LIMIT_BYTES = 3_000_000
HTML = "<!doctype html><title>A page of a test</title>"
HOST = b"Host: 127.0.0.1:{port}\r\n"
KNOWN = HOST + b"Cookie: {cookie}\r\n"
UPGRADE = b"Connection: Upgrade\r\nUpgrade: websocket\r\n"


def until(happened: Callable[[], bool]) -> None:
    """Wait for what must come, with patience."""
    deadline = time.monotonic() + PATIENCE_S
    while not happened():
        assert time.monotonic() < deadline, "it has not come"
        time.sleep(0.01)


class Stub:
    """A page that welcomes, takes files, gives back what it understood, and fails where it is told to."""

    def __init__(self) -> None:
        self.uploads = Uploads(LIMIT_BYTES)
        self.routes = [
            Route("/files/{name}", self.put, methods=["PUT"]),
            Route("/fail", self.fail),
            Route("/tell", self.tell),
        ]
        self.viewers = 0

    async def wire(self, websocket: WebSocket) -> None:
        await websocket.accept()
        self.viewers += 1
        try:
            await websocket.send_text(text({"kind": "welcome"}))
            while True:
                await self.answer(websocket)
        finally:
            self.viewers -= 1

    async def answer(self, websocket: WebSocket) -> None:
        frame = await websocket.receive()
        if frame["type"] == "websocket.disconnect":
            websocket._raise_on_disconnect(frame)
        try:
            said = parse_frame(frame)
        except BecalmError as cause:
            await websocket.send_text(text({"kind": "trouble", "says": str(cause)}))
            return
        if said.get("do") == "fail":
            raise RuntimeError("as it was told to")
        await websocket.send_text(text({"kind": "heard", "said": said}))

    async def put(self, request: Request) -> Response:
        kept = await self.uploads.store(request, request.path_params["name"])
        return PlainTextResponse(kept.name)

    async def fail(self, request: Request) -> Response:
        await asyncio.sleep(0)
        raise RuntimeError("as it was told to")

    async def tell(self, request: Request) -> Response:
        await asyncio.sleep(0)
        raise BecalmError("caf\udce9.csv is not there.")


class Served(NamedTuple):
    """A page that is served."""

    page: Stub
    access: Access

    @property
    def base(self) -> str:
        return f"http://{LOOPBACK}:{self.access.port}"

    @property
    def cookie(self) -> str:
        return f"{self.access.cookie}={TOKEN}"

    def client(self) -> httpx.Client:
        """Return a browser that has been let in."""
        return httpx.Client(base_url=self.base, headers={"cookie": self.cookie}, timeout=PATIENCE_S, trust_env=False)

    def stranger(self) -> httpx.Client:
        """Return a browser that knows no token."""
        return httpx.Client(base_url=self.base, timeout=PATIENCE_S, trust_env=False)

    def wire(self, origin: str | None = "ours", cookie: str | None = "ours", host: str = LOOPBACK) -> ClientConnection:
        """Return a WebSocket; "ours" is what a browser on the page would bring."""
        headers = [("Cookie", self.cookie if cookie == "ours" else cookie)] if cookie else []
        return connect(
            f"ws://{host}:{self.access.port}/wire",
            origin=self.base if origin == "ours" else origin,  # type: ignore[arg-type]  # a str by another name
            additional_headers=headers,
            sock=socket.create_connection((LOOPBACK, self.access.port)),
            open_timeout=PATIENCE_S,
            max_size=None,
            proxy=None,
        )

    def raw(self, sent: bytes) -> bytes:
        """Send bytes as they are, and return all that is answered until the server hangs up."""
        with socket.create_connection((LOOPBACK, self.access.port), PATIENCE_S) as link:
            link.sendall(sent)
            parts = []
            try:
                while part := link.recv(65536):
                    parts.append(part)
            except ConnectionResetError:  # hung up amid what was sent
                pass
            return b"".join(parts)


@contextmanager
def served(host: str = LOOPBACK) -> Iterator[Served]:
    """Serve a page."""
    listener = listen(host, 0)
    access = Access(host, listener.getsockname()[1], TOKEN)
    page = Stub()
    try:
        with Server(listener, site(Page(HTML, page.wire, page.routes), access)):
            yield Served(page, access)
    finally:
        page.uploads.close()


def link(page: Served) -> socket.socket:
    """Return a connection that has said nothing yet."""
    return socket.create_connection((LOOPBACK, page.access.port), 30)


def filled(page: Served, request: bytes) -> bytes:
    """Return a request with the page's port and cookie."""
    return request.replace(b"{port}", str(page.access.port).encode()).replace(b"{cookie}", page.cookie.encode())


def still_served(page: Served) -> bool:
    """Whether the page answers others."""
    with page.client() as browser:
        return browser.get("/").text == HTML


def hung_up(open_link: socket.socket) -> bool:
    """Wait until the server hangs up; False if it answers instead."""
    try:
        return open_link.recv(1) == b""
    except ConnectionResetError:
        return True
