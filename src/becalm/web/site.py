"""Build the web application of a page: its HTML, its assets, its WebSocket and its other routes."""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import quote

from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from becalm.errors import BecalmError
from becalm.report.vendor import uplot
from becalm.web.access import Access
from becalm.web.frames import UNFORESEEN
from becalm.web.guard import Guard
from becalm.web.uploads import RefusedError

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

_KINDS = {"js": "text/javascript", "css": "text/css", "svg": "image/svg+xml"}


class Page(NamedTuple):
    """The parts of a page.

    Attributes
    ----------
    html : str
        Text of the page.
    wire : callable
        Function that accepts a WebSocket, and exchanges messages with it until it is closed.
    routes : sequence of routes
        Other routes, such as downloads.
    """

    html: str
    wire: Callable[[WebSocket], Awaitable[None]]
    routes: Sequence[BaseRoute] = ()


def html_of(name: str) -> str:
    """Return the HTML of a page from the file `name` in web/assets."""
    return (files("becalm.web") / "assets" / name).read_text(encoding="utf-8")


def site(page: Page, access: Access) -> Guard:
    """Return the application of a page, behind its guard.

    Raises
    ------
    BecalmError
        If becalm runs from sources that were never installed.
    """
    table = assets()

    async def html(request: Request) -> Response:
        return HTMLResponse(page.html)

    async def asset(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in table:
            return PlainTextResponse("The page has no such file.", 404)
        return Response(table[name], media_type=_KINDS[name.rpartition(".")[2]])

    async def converse(websocket: WebSocket) -> None:
        try:
            await page.wire(websocket)
        except WebSocketDisconnect:
            return

    routes = [Route("/", html), Route("/assets/{name:path}", asset), WebSocketRoute("/wire", converse), *page.routes]
    handlers = {BecalmError: _refused, ClientDisconnect: _gone, Exception: _unforeseen}
    return Guard(Starlette(routes=routes, exception_handlers=handlers), access)


def as_file(name: str) -> dict[str, str]:
    """Return the header that makes a browser save a response as a file; the name may contain invalid Unicode."""
    return {"content-disposition": f"attachment; filename*=UTF-8''{quote(os.fsencode(name))}"}


def assets() -> dict[str, bytes]:
    """Return the contents of the files that pages may load, by name; a request for another name gets no file."""
    javascript, css = uplot()
    table = {"uPlot.iife.min.js": javascript.encode(), "uPlot.min.css": css.encode()}
    for package in ("becalm.report", "becalm.web"):  # pages use the scripts of the report's figures too
        _gather(files(package) / "assets", "", table)
    return table


def _gather(folder: Traversable, before: str, table: dict[str, bytes]) -> None:
    for entry in folder.iterdir():
        if entry.is_dir():
            _gather(entry, f"{before}{entry.name}/", table)
        elif entry.name.rpartition(".")[2] in _KINDS:
            table[before + entry.name] = entry.read_bytes()


def _refused(request: Request, cause: Exception) -> Response:
    """Return a response with the message of an error that a person can correct."""
    status = cause.status if isinstance(cause, RefusedError) else 400
    says = str(cause).encode("utf-8", "replace")  # names of files may contain invalid Unicode
    return PlainTextResponse(says, status, {"connection": "close"})


def _gone(request: Request, cause: Exception) -> Response:
    """Return a response that is not sent, because the page has disconnected."""
    return Response(status_code=400)


def _unforeseen(request: Request, cause: Exception) -> Response:
    """Return a response with a sentence about an unexpected error; the guard logs the exception."""
    return PlainTextResponse(UNFORESEEN, 500)
