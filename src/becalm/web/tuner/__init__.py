"""The tuner: a recording and its filter on a page, with a dial between quick and calm."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from pathlib import Path

from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket

from becalm.errors import InputError, OutputError
from becalm.files.read_options import ReadOptions
from becalm.web.site import as_file
from becalm.web.tuner.naming import stem_of
from becalm.web.tuner.opened import AS_IT_IS, Opened
from becalm.web.tuner.saving import CleaningJob, Made, cleaned, reported
from becalm.web.tuner.session import Conversation
from becalm.web.tuner.sharing import Shared

__all__ = ["Tuner"]


class Tuner:
    """The server's side of the tuner's page.

    Parameters
    ----------
    folder : Path
        Whose files may be opened.
    file : Path or None
        What is opened first, wherever it is.
    upload_limit : int
        Bytes of a file that a page may bring.
    options : ReadOptions
        What was said of the time of the file that is opened first.

    Attributes
    ----------
    routes : list of Route
        What is answered beside the page itself: uploads and downloads.
    """

    def __init__(self, folder: Path, file: Path | None, upload_limit: int, options: ReadOptions = AS_IT_IS) -> None:
        self._shared = Shared(folder, file, upload_limit, options)
        self._saving = asyncio.Semaphore(1)  # each save is a process of its own
        self.routes = [
            Route("/files/{name:path}", self._bring, methods=["PUT"]),
            Route("/save/recipe", self._save_recipe),
            Route("/save/clean", self._save_clean),
            Route("/save/report", self._save_report),
        ]

    async def wire(self, websocket: WebSocket) -> None:
        """Speak with a page until it is closed."""
        await Conversation(self._shared, websocket).run()

    def close(self) -> None:
        """End what computes, and remove what was brought."""
        self._shared.close()

    async def _bring(self, request: Request) -> Response:
        path = await self._shared.uploads.take(request, request.path_params["name"])
        return JSONResponse({"file": self._shared.folder.bring(path)})

    async def _save_recipe(self, request: Request) -> Response:
        desk = self._shared.open_desk
        name = f"{stem_of(desk.opened.path)}.recipe.toml"
        return Response(desk.recipe().to_toml(), media_type="application/toml", headers=as_file(name))

    async def _save_clean(self, request: Request) -> Response:
        ending = request.query_params.get("format", "csv").removeprefix(".")
        return _Download(await _while_there(request, self._saved(lambda job: cleaned(job, ending))))

    async def _save_report(self, request: Request) -> Response:
        return _Download(await _while_there(request, self._saved(reported)))

    async def _saved(self, make: Callable[[CleaningJob], Awaitable[Made]]) -> Made:
        """Save what is set now, of what was opened, once those who asked before have theirs."""
        desk = self._shared.open_desk
        opened, recipe = desk.opened, desk.recipe().to_toml()
        async with self._saving:
            try:
                made = await make(
                    CleaningJob(self._unchanged(opened), recipe, opened.group if opened.several else None)
                )
            except OutputError:
                self._unchanged(opened)  # or that is why
                raise
        try:
            self._unchanged(opened)  # nor did it change while it was read again
        except InputError:
            made.close()
            raise
        return made

    def _unchanged(self, opened: Opened) -> Path:
        """Return where a file is that is still what was opened."""
        try:
            path = self._shared.folder.path_of(opened.id)
        except InputError as cause:
            raise InputError(f"{opened.path.name} is not there any more; open another file.") from cause
        if not opened.is_unchanged(path):
            raise InputError(f"{path.name} changed since it was opened; open it again.")
        return path


async def _while_there(request: Request, work: Coroutine[None, None, Made]) -> Made:
    """Wait for work, which ends where nobody waits for it any more."""
    job, gone = asyncio.ensure_future(work), asyncio.ensure_future(_gone(request))
    try:
        await asyncio.wait((job, gone), return_when=asyncio.FIRST_COMPLETED)
        if job.done():
            return job.result()
        raise ClientDisconnect
    finally:
        job.cancel()
        gone.cancel()
        await asyncio.gather(job, gone, return_exceptions=True)


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


class _Download(StreamingResponse):
    """A file that was made, which goes once it was sent, or nobody wants it."""

    def __init__(self, made: Made) -> None:
        headers = {**as_file(made.name), "content-length": str(made.bytes)}
        super().__init__(made.blocks(), media_type="application/octet-stream", headers=headers)
        self._made = made

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send it."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._made.close()
