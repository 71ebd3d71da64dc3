"""Queue the pictures of a page: the newest request first, quick ones before slow ones."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from becalm.errors import UsageError
from becalm.web.tuner import messages
from becalm.web.tuner.judging import judged
from becalm.web.tuner.messages import Look
from becalm.web.tuner.outgoing_messages import Wire
from becalm.web.tuner.painting import Painter, PictureRequest, dial_frame, map_frame

if TYPE_CHECKING:
    from becalm.web.tuner.sharing import Shared

_WIDTH = 2000  # stretches, until a page says how many it has room for


@dataclass
class _Shown:
    """What a page was shown beside pictures since it was told from the beginning."""

    dial: tuple[object, ...] = ()
    figures: tuple[object, ...] = ()


class Showing:
    """The pictures of one page.

    Parameters
    ----------
    shared : Shared
        The desk, and the threads that paint.
    wire : Wire
        The way to the page.

    Attributes
    ----------
    dragging : bool
        Whether the dial is held: what takes longer waits then.
    answers : int
        The newest message that the next picture answers.
    """

    def __init__(self, shared: Shared, wire: Wire) -> None:
        self._shared, self._wire = shared, wire
        self._painter = Painter(shared.halves)
        self._look = Look(number=0, do="look", channel=0, width=_WIDTH)
        self._classics: dict[int, str] = {}
        self._asked, self.answers, self._shown = asyncio.Event(), 0, _Shown()
        self.dragging = False

    async def run(self) -> None:
        """Paint whatever is asked for, and then, while nothing is, what takes longer."""
        while True:
            await self._asked.wait()
            self._asked.clear()
            await self._wire.guarded(self._show_newest, self.answers)

    def begin(self) -> None:
        """Show the page all of what is open now, as if nothing had been shown."""
        self._look = Look(number=0, do="look", channel=0, width=self._look.width)
        self._shown = _Shown()
        self._classics.clear()

    def wait(self) -> None:
        """Paint nothing until it is asked for again."""
        self._asked.clear()

    def ask(self, number: int | None = None) -> None:
        """Ask for a picture; one that was asked for and not begun is not painted any more."""
        self.answers = self.answers if number is None else number
        self._asked.set()

    def look(self, look: Look) -> None:
        """Look at a part of a channel."""
        self._shared.open_desk.opened.check_channel(look.channel)
        self._look = look
        self.ask(look.number)

    def turned(self, channel: int, number: int) -> None:
        """Look at the channel whose dial was turned."""
        self._look = self._look.model_copy(update={"channel": channel})
        self.ask(number)

    def compare(self, message: messages.Compare) -> None:
        """Draw a classic filter beside a channel, or none.

        Raises
        ------
        UsageError
            If it is none to compare with.
        """
        desk = self._shared.open_desk
        desk.opened.check_channel(message.channel)
        if message.classic is None:
            self._classics.pop(message.channel, None)
        elif message.classic in desk.classics:
            self._classics[message.channel] = message.classic
        else:
            raise UsageError("That classic filter is not one to compare with in this mode; choose one that is offered.")
        self.ask(message.number)

    async def map(self, message: messages.Map) -> None:
        """Tell how well every noise and density foretells readings."""
        in_thread = self._shared.in_thread
        wanted = await in_thread(lambda: self._wanted(message.number, message.channel))
        await self._wire.send(await in_thread(lambda: map_frame(wanted)))

    def _wanted(self, answers: int, channel: int) -> PictureRequest:
        desk, look = self._shared.open_desk, self._look
        span_s = (
            -math.inf if look.from_s is None else look.from_s,
            math.inf if look.to_s is None else look.to_s,
        )
        classic = self._classics.get(channel)
        if classic not in desk.classics:  # it was of another mode
            classic = None
        recipe, lag = desk.channel(channel), desk.lag
        how = (recipe, lag, span_s, look.width, answers, classic, self.dragging)
        return PictureRequest(desk.opened, channel, *how, setting=desk.setting_told(channel))

    async def _show_newest(self) -> None:
        in_thread, painter = self._shared.in_thread, self._painter
        wanted, shown = self._wanted(self.answers, self._look.channel), self._shown
        if not wanted.hurried and await in_thread(lambda: painter.hurries(wanted)):
            await self._wire.send(await in_thread(lambda: painter.picture(wanted._replace(hurried=True)).framed()))
            if self._asked.is_set():
                return
        painted = await in_thread(lambda: painter.picture(wanted))
        await self._wire.send(painted.framed())
        if self._asked.is_set():
            return
        if shown.dial != wanted.dial_key:
            await self._wire.send(await in_thread(lambda: dial_frame(wanted)))
            shown.dial = wanted.dial_key
        if wanted.classic is not None and not self._asked.is_set():
            await self._wire.send(await in_thread(lambda: painter.classic(wanted, painted)))
        if not self._asked.is_set():
            await in_thread(lambda: painter.remember(wanted, painted))
        if not (self.dragging or self._asked.is_set() or shown.figures == wanted.judged_key):
            await self._judge(wanted, shown)

    async def _judge(self, wanted: PictureRequest, shown: _Shown) -> None:
        recipe = self._shared.open_desk.recipe_of_all()

        def judge() -> dict[str, Any] | None:
            rows = wanted.opened.rows(wanted.channel)
            return judged(rows, recipe, wanted.recipe, wanted.channel, self._is_quiet)

        figures = await self._shared.in_thread(judge)
        if figures is not None:
            await self._wire.tell({**figures, "of": wanted.setting})
            shown.figures = wanted.judged_key

    def _is_quiet(self) -> bool:
        return not (self._asked.is_set() or self._wire.gone)
