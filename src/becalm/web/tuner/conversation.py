"""A page and the tuner in conversation: what is asked changes the desk at once; pictures follow, the newest wins."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from starlette.websockets import WebSocket, WebSocketDisconnect

from becalm.errors import BecalmError, UsageError
from becalm.web.frames import text
from becalm.web.hearing import heard
from becalm.web.tuner import messages
from becalm.web.tuner.judging import judged
from becalm.web.tuner.messages import Look, understood
from becalm.web.tuner.painting import Painter, Wanted, dial_frame, map_frame

if TYPE_CHECKING:
    from becalm.web.tuner.desk import Desk
    from becalm.web.tuner.sharing import Shared

_WIDTH = 2000  # stretches, until a page says how many it has room for

_UNFORESEEN = "Something went wrong in becalm that nobody foresaw; its error output says what."

_log = logging.getLogger(__name__)

T = TypeVar("T")

Telling = Callable[["Conversation"], Coroutine[Any, Any, None]]
"""Tells a page something."""


@dataclass
class _Shown:
    """What a page was shown beside pictures since it was told from the beginning."""

    dial: tuple[object, ...] = ()
    figures: tuple[object, ...] = ()


class Conversation:
    """One page.

    Parameters
    ----------
    shared : Shared
        The desk, and what all pages have in common.
    websocket : WebSocket
        The page's wire.
    """

    def __init__(self, shared: Shared, websocket: WebSocket) -> None:
        self._shared, self._websocket = shared, websocket
        self._painter = Painter(shared.halves)
        self._look = Look(number=0, do="look", channel=0, width=_WIDTH)
        self._classics: dict[int, str] = {}
        self._answers, self._dragging, self._gone = 0, False, False
        self._asked = asyncio.Event()
        self._shown = _Shown()
        self._sending = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()
        self._mapping: asyncio.Task[None] | None = None

    async def run(self) -> None:
        """Speak with the page until it is closed."""
        await self._websocket.accept()
        await self._tell(self._shared.welcome())
        self._start(self._show())
        try:
            if self._shared.desk is not None:
                await self.told_anew()
            elif self._shared.first is not None:
                self._start(self._guarded(self._open(self._shared.first, None), None))
            while True:
                frame = await self._websocket.receive()
                if frame["type"] == "websocket.disconnect":
                    return
                await self._hear(frame)
        except WebSocketDisconnect:
            return
        finally:
            self._gone = True
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)

    async def told_anew(self) -> None:
        """Tell the page what is open, and what is set, from the beginning."""
        desk = self._desk
        self._look = Look(number=0, do="look", channel=0, width=self._look.width)
        self._shown = _Shown()
        self._classics.clear()
        await self._tell(await self._in_thread(desk.recording_told))
        await self.told_state()

    async def told_state(self, but: Conversation | None = None) -> None:
        """Tell the page what is set, and show it; `but` is the page whose picture is already on its way."""
        if but is not self:
            self._ask(self._answers)
        await self._tell(await self._in_thread(self._desk.state_told))

    def tell(self, what: Telling) -> None:
        """Tell the page something beside all else: another one does not wait until this one hears."""

        async def telling() -> None:
            with suppress(WebSocketDisconnect):
                await self._guarded(what(self), None)

        if not self._gone:
            self._start(telling())

    async def working(self, says: str) -> None:
        """Tell the page what is being done; "" of nothing any more."""
        await self._tell({"kind": "working", "says": says})

    async def _hear(self, frame: Mapping[str, Any]) -> None:
        number: int | None = None
        try:
            said = heard(frame)
            number = said["number"] if type(said.get("number")) is int else None
            message = understood(said)
        except BecalmError as cause:
            await self._trouble(str(cause), number)
            return
        await self._guarded(self._do(message), message.number)

    async def _guarded(self, doing: Awaitable[None], number: int | None) -> None:
        """Do something, and tell the page in a sentence where it cannot be done."""
        try:
            await doing
        except WebSocketDisconnect:
            raise
        except BecalmError as cause:
            await self._trouble(str(cause), number)
        except Exception:  # the page goes on, and whoever runs becalm is told
            if not self._gone:
                _log.exception("What a page asked for failed.")
                await self._trouble(_UNFORESEEN, number)

    async def _do(self, message: messages.Message) -> None:
        match message:
            case messages.Open():
                await self._open(message.file, message.group)
            case messages.ListFiles():
                await self._tell({"kind": "files", **self._shared.files()})
            case messages.Look():
                self._desk.opened.rows(message.channel)
                self._look = message
                self._ask(message.number)
            case messages.Turn():
                await self._turn(message)
            case messages.Map():
                if self._mapping is not None:
                    self._mapping.cancel()
                self._mapping = self._start(self._guarded(self._map(message), message.number))
            case messages.Compare():
                self._compare(message)
            case _:
                await self._change(message)

    async def _open(self, file: str, group: str | None) -> None:
        if self._shared.is_open(file, group):
            await self.told_anew()
            return
        self._asked.clear()
        await self._shared.open(file, group)
        await self._shared.tell_all(Conversation.told_anew, self)

    async def _turn(self, message: messages.Turn) -> None:
        desk = self._desk

        def turn() -> None:
            desk.turn(message.channel, message.settings, final=message.final)

        if message.settings.choice is None and message.settings.on is None:
            turn()
        else:
            await self._in_thread(turn)  # a model of another order may have to be looked at first
        self._dragging = not message.final
        self._look = self._look.model_copy(update={"channel": message.channel})
        self._ask(message.number)
        if message.final:
            await self._shared.tell_all(lambda page: page.told_state(but=self), self)

    async def _change(self, message: messages.Message) -> None:
        desk = self._desk
        before = desk.options
        try:
            match message:
                case messages.InMode():
                    await self._in_thread(lambda: desk.put_in_mode(message.mode, message.lag_s))
                    self._classics.clear()
                case messages.Undo():
                    desk.undo()
                case messages.Redo():
                    desk.redo()
                case messages.Restore():
                    await self._in_thread(lambda: desk.restore(message.recipe))
        except BaseException:
            await self._shared.working("")
            raise
        self._dragging = False
        self._answers = message.number
        anew = isinstance(message, messages.Restore) or desk.options is not before  # of the other mode
        await self._shared.tell_all(Conversation.told_anew if anew else Conversation.told_state, self)

    async def _map(self, message: messages.Map) -> None:
        wanted = await self._in_thread(lambda: self._wanted(message.number, message.channel))
        await self._send(await self._in_thread(lambda: map_frame(wanted)))

    def _compare(self, message: messages.Compare) -> None:
        self._desk.opened.rows(message.channel)
        if message.classic is None:
            self._classics.pop(message.channel, None)
        elif message.classic in self._desk.classics:
            self._classics[message.channel] = message.classic
        else:
            raise UsageError("That classic filter is not one to compare with in this mode; choose one that is offered.")
        self._ask(message.number)

    def _ask(self, number: int) -> None:
        """Ask for a picture; one that was asked for and not begun is not painted any more."""
        self._answers = number
        self._asked.set()

    def _wanted(self, answers: int, channel: int) -> Wanted:
        desk, look = self._desk, self._look
        span_s = (
            -math.inf if look.from_s is None else look.from_s,
            math.inf if look.to_s is None else look.to_s,
        )
        recipe = desk.channel(channel)
        classic = self._classics.get(channel)
        if classic not in desk.classics:  # it was of another mode
            classic = None
        lag, hurried = desk.lag, self._dragging
        return Wanted(desk.opened, channel, recipe, lag, span_s, look.width, answers, classic, hurried)

    async def _show(self) -> None:
        """Paint whatever is asked for, and then, while nothing is, what takes longer."""
        while True:
            await self._asked.wait()
            self._asked.clear()
            await self._guarded(self._show_newest(), self._answers)

    async def _show_newest(self) -> None:
        wanted, shown = self._wanted(self._answers, self._look.channel), self._shown
        painted = await self._in_thread(lambda: self._painter.picture(wanted))
        await self._send(painted.framed())
        if self._asked.is_set():
            return
        if shown.dial != wanted.dial_key:
            await self._send(await self._in_thread(lambda: dial_frame(wanted)))
            shown.dial = wanted.dial_key
        if wanted.classic is not None and not self._asked.is_set():
            await self._send(await self._in_thread(lambda: self._painter.classic(wanted, painted)))
        if not self._asked.is_set():
            await self._in_thread(lambda: self._painter.remember(wanted, painted))
        if not (self._dragging or self._asked.is_set() or shown.figures == wanted.judged_key):
            await self._judge(wanted, shown)

    async def _judge(self, wanted: Wanted, shown: _Shown) -> None:
        recipe = self._desk.recipe_of_all()

        def judge() -> dict[str, Any] | None:
            rows = wanted.opened.rows(wanted.channel)
            return judged(rows, recipe, wanted.recipe, wanted.channel, self._is_quiet)

        figures = await self._in_thread(judge)
        if figures is not None:
            await self._tell(figures)
            shown.figures = wanted.judged_key

    def _is_quiet(self) -> bool:
        return not (self._asked.is_set() or self._gone)

    @property
    def _desk(self) -> Desk:
        if self._shared.desk is None:
            raise UsageError("Nothing is open yet; choose a file, or drop one here.")
        return self._shared.desk

    async def _in_thread(self, work: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._shared.workers, work)

    def _start(self, doing: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task: asyncio.Task[None] = asyncio.create_task(doing)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def _trouble(self, says: str, answers: int | None) -> None:
        await self._tell({"kind": "trouble", "says": says, "answers": answers})

    async def _tell(self, message: dict[str, Any]) -> None:
        async with self._sending:
            await self._websocket.send_text(text(message))

    async def _send(self, data: bytes) -> None:
        async with self._sending:
            await self._websocket.send_bytes(data)
