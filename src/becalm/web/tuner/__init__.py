"""Serve the tuner: a page that shows a recording and its filter, with a dial between fast and smooth output."""

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
from becalm.web.tuner.opened import AS_IT_IS, OpenRecording
from becalm.web.tuner.saving import CleaningJob, TemporaryOutput, clean_file, write_report
from becalm.web.tuner.sharing import Shared
from becalm.web.tuner.tuner_session import TunerSession

__all__ = ["Tuner"]


class Tuner:
    """The server's side of the tuner's page.

    Parameters
    ----------
    folder : Path
        Folder whose files may be opened.
    file : Path or None
        File to open first, in any folder.
    upload_limit : int
        Size limit of a file that a page uploads, in bytes.
    options : ReadOptions
        Options for the time base of the file to open first.

    Attributes
    ----------
    routes : list of Route
        Routes of uploads and downloads.
    """

    def __init__(self, folder: Path, file: Path | None, upload_limit: int, options: ReadOptions = AS_IT_IS) -> None:
        self._shared = Shared(folder, file, upload_limit, options)
        self._saving = asyncio.Semaphore(1)  # one save at a time, because each runs a subprocess
        self.routes = [
            Route("/files/{name:path}", self._upload, methods=["PUT"]),
            Route("/save/recipe", self._save_recipe),
            Route("/save/clean", self._save_clean),
            Route("/save/report", self._save_report),
        ]

    async def wire(self, websocket: WebSocket) -> None:
        """Exchange messages with a page until it is closed."""
        await TunerSession(self._shared, websocket).run()

    def close(self) -> None:
        """Stop the threads, and remove uploaded files."""
        self._shared.close()

    async def _upload(self, request: Request) -> Response:
        path = await self._shared.uploads.store(request, request.path_params["name"])
        return JSONResponse({"file": self._shared.folder.add_uploaded(path)})

    async def _save_recipe(self, request: Request) -> Response:
        view_model = self._shared.current_view_model
        name = f"{stem_of(view_model.opened.path)}.recipe.toml"
        return Response(view_model.recipe().to_toml(), media_type="application/toml", headers=as_file(name))

    async def _save_clean(self, request: Request) -> Response:
        ending = request.query_params.get("format", "csv").removeprefix(".")
        return _Download(await _until_disconnect(request, self._save(lambda job: clean_file(job, ending))))

    async def _save_report(self, request: Request) -> Response:
        return _Download(await _until_disconnect(request, self._save(write_report)))

    async def _save(self, make: Callable[[CleaningJob], Awaitable[TemporaryOutput]]) -> TemporaryOutput:
        """Save the open recording with the present settings, after earlier saves have finished."""
        view_model = self._shared.current_view_model
        opened, recipe = view_model.opened, view_model.recipe().to_toml()
        async with self._saving:
            try:
                made = await make(
                    CleaningJob(
                        self._unchanged_path(opened), recipe, opened.group if opened.has_several_groups else None
                    )
                )
            except OutputError:
                self._unchanged_path(opened)  # a changed file may be the cause, and raises a clearer error
                raise
        try:
            self._unchanged_path(opened)  # the file may have changed while it was read again
        except InputError:
            made.close()
            raise
        return made

    def _unchanged_path(self, opened: OpenRecording) -> Path:
        """Return the path of the open file; raise an InputError if the file has changed or is gone."""
        try:
            path = self._shared.folder.path_of(opened.id)
        except InputError as cause:
            raise InputError(f"{opened.path.name} no longer exists; open another file.") from cause
        if not opened.is_unchanged(path):
            raise InputError(f"{path.name} changed since it was opened; open it again.")
        return path


async def _until_disconnect(request: Request, work: Coroutine[None, None, TemporaryOutput]) -> TemporaryOutput:
    """Await some work; cancel it and raise a ClientDisconnect if the client disconnects."""
    job, gone = asyncio.ensure_future(work), asyncio.ensure_future(_wait_for_disconnect(request))
    try:
        await asyncio.wait((job, gone), return_when=asyncio.FIRST_COMPLETED)
        if job.done():
            return job.result()
        raise ClientDisconnect
    finally:
        job.cancel()
        gone.cancel()
        await asyncio.gather(job, gone, return_exceptions=True)


async def _wait_for_disconnect(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


class _Download(StreamingResponse):
    """A response that sends a temporary file and then removes it, even if the client disconnects."""

    def __init__(self, made: TemporaryOutput) -> None:
        headers = {**as_file(made.name), "content-length": str(made.bytes)}
        super().__init__(made.blocks(), media_type="application/octet-stream", headers=headers)
        self._made = made

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file, and remove it."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._made.close()
