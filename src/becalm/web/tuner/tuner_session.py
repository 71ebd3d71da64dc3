"""The session of one page of the tuner: it applies requests to the view model, and sends messages and pictures."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from contextlib import suppress
from typing import Any

from starlette.websockets import WebSocket, WebSocketDisconnect

from becalm.errors import BecalmError
from becalm.web.incoming_messages import number_of, parse_frame
from becalm.web.tuner import messages
from becalm.web.tuner.messages import parse_message
from becalm.web.tuner.outgoing_messages import Wire
from becalm.web.tuner.picture_sender import PictureSender
from becalm.web.tuner.sharing import Sender, Shared


class TunerSession:
    """The session of one page.

    Parameters
    ----------
    shared : Shared
        View model and threads, common to all pages.
    websocket : WebSocket
        Connection to the page.
    """

    def __init__(self, shared: Shared, websocket: WebSocket) -> None:
        self._shared, self._websocket = shared, websocket
        self._wire = Wire(websocket)
        self._pictures = PictureSender(shared, self._wire)
        self._tasks: set[asyncio.Task[None]] = set()
        self._cost_map_task: asyncio.Task[None] | None = None
        self._last_change = 0  # number of the last message that changed a setting

    async def run(self) -> None:
        """Exchange messages with the page until it is closed."""
        await self._websocket.accept()
        await self._wire.send_message(await self._shared.in_thread(self._shared.welcome))
        self._shared.pages.add(self)
        self._start(self._pictures.run)
        try:
            if self._shared.view_model is not None:
                await self.send_all()
            elif (first := self._shared.first) is not None:
                self._start(lambda: self._wire.report_errors(lambda: self._open(first, None, None), None))
            while True:
                frame = await self._websocket.receive()
                if frame["type"] == "websocket.disconnect":
                    return
                await self._receive(frame)
        except WebSocketDisconnect:
            return
        finally:
            self._wire.gone = True
            self._shared.pages.discard(self)
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)

    async def send_all(self) -> None:
        """Send the page the open recording and all settings."""
        view_model = self._shared.current_view_model
        self._pictures.reset()
        await self._wire.send_message(await self._shared.in_thread(view_model.recording_message))
        await self.send_state()

    async def send_state(self, requester: TunerSession | None = None) -> None:
        """Send the page all settings; also a new picture, unless this page is `requester`, which has requested one."""
        if requester is not self:
            self._pictures.request_picture()
        last_change = self._last_change
        await self._wire.send_message(
            {**await self._shared.in_thread(self._shared.current_view_model.state_message), "turned": last_change}
        )

    def start_sending(self, what: Sender) -> None:
        """Start a task that sends the page something; other pages do not wait for this page."""
        if not self._wire.gone:
            self._start(lambda: self._wire.report_errors(lambda: what(self), None))

    async def send_progress(self, says: str) -> None:
        """Send the page a sentence on the work in progress; "" if it is finished."""
        await self._wire.send_message({"kind": "working", "says": says})

    async def _receive(self, frame: Mapping[str, Any]) -> None:
        number: int | None = None
        try:
            content = parse_frame(frame)
            number = number_of(content)
            message = parse_message(content)
        except BecalmError as cause:
            await self._wire.send_error(str(cause), number)
            return
        await self._wire.report_errors(lambda: self._do(message), message.number)

    async def _do(self, message: messages.Message) -> None:
        match message:
            case messages.Open():
                await self._open(message.file, message.group, message.rate_hz)
            case messages.ListFiles():
                await self._wire.send_message({"kind": "files", **await self._shared.in_thread(self._shared.files)})
            case messages.Look():
                self._pictures.look(message)
            case messages.Turn():
                await self._turn(message)
            case messages.Map():
                if self._cost_map_task is not None:
                    self._cost_map_task.cancel()
                self._cost_map_task = self._start(
                    lambda: self._wire.report_errors(lambda: self._pictures.map(message), message.number)
                )
            case messages.Compare():
                self._pictures.compare(message)
            case _:
                await self._change(message)

    async def _open(self, file: str, group: str | None, rate_hz: float | None) -> None:
        if self._shared.is_open(file, group, rate_hz):
            await self.send_all()
            return
        await self._shared.open(file, group, rate_hz)
        self._pictures.drop_request()
        await self._shared.broadcast(TunerSession.send_all, self)

    async def _turn(self, message: messages.Turn) -> None:
        view_model = self._shared.current_view_model

        def turn() -> None:
            view_model.turn(message.channel, message.settings, final=message.final)

        if message.settings.choice is None and message.settings.on is None:
            turn()
        else:
            await self._shared.in_thread(turn)  # a model of another order may have to be computed first
        self._last_change = message.number
        self._pictures.dragging = not message.final
        self._pictures.show_channel(message.channel, message.number)
        if message.final:
            await self._shared.broadcast(lambda page: page.send_state(requester=self), self)

    async def _change(self, message: messages.Message) -> None:
        view_model, in_thread = self._shared.current_view_model, self._shared.in_thread
        before = view_model.options
        try:
            match message:
                case messages.SetMode():
                    await in_thread(lambda: view_model.set_mode(message.mode, message.lag_s))
                case messages.Undo():
                    view_model.undo()
                case messages.Redo():
                    view_model.redo()
                case messages.Restore():
                    await in_thread(lambda: view_model.restore(message.recipe))
        except BaseException:
            await self._shared.send_progress("")
            raise
        self._pictures.dragging = False
        self._pictures.answers = message.number
        has_new_options = isinstance(message, messages.Restore) or view_model.options is not before
        await self._shared.broadcast(TunerSession.send_all if has_new_options else TunerSession.send_state, self)

    def _start(self, work: Callable[[], Coroutine[Any, Any, None]]) -> asyncio.Task[None]:
        """Start a task, which is cancelled when the page is closed."""

        async def quietly() -> None:
            with suppress(WebSocketDisconnect):
                await work()

        task = asyncio.create_task(quietly())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task
