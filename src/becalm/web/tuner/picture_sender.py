"""Send the pictures that a page requests: only the newest one, and slow figures after fast ones."""

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

_WIDTH = 2000  # stretches of a picture, until a page sends its own number


@dataclass
class _Shown:
    """The keys of the dial and of the figures that a page has; empty after a new recording."""

    dial: tuple[object, ...] = ()
    figures: tuple[object, ...] = ()


class PictureSender:
    """Computes and sends the pictures of one page.

    Parameters
    ----------
    shared : Shared
        View model and threads, common to all pages.
    wire : Wire
        Connection to the page.

    Attributes
    ----------
    dragging : bool
        Whether the person drags the dial; the slow figures wait meanwhile.
    answers : int
        Number of the newest message that the next picture answers.
    """

    def __init__(self, shared: Shared, wire: Wire) -> None:
        self._shared, self._wire = shared, wire
        self._painter = Painter(shared.halves)
        self._look = Look(number=0, do="look", channel=0, width=_WIDTH)
        self._classics: dict[int, str] = {}
        self._requested, self.answers, self._shown = asyncio.Event(), 0, _Shown()
        self.dragging = False

    async def run(self) -> None:
        """Send requested pictures, and slow figures while none is requested; this never ends."""
        while True:
            await self._requested.wait()
            self._requested.clear()
            await self._wire.guarded(self._show_newest, self.answers)

    def begin(self) -> None:
        """Forget what the page has: a new recording was opened."""
        self._look = Look(number=0, do="look", channel=0, width=self._look.width)
        self._shown = _Shown()
        self._classics.clear()

    def wait(self) -> None:
        """Drop the present request."""
        self._requested.clear()

    def ask(self, number: int | None = None) -> None:
        """Request a picture; the request replaces one that has not started, and may answer a message."""
        self.answers = self.answers if number is None else number
        self._requested.set()

    def look(self, look: Look) -> None:
        """Request a part of a channel."""
        self._shared.open_desk.opened.check_channel(look.channel)
        self._look = look
        self.ask(look.number)

    def turned(self, channel: int, number: int) -> None:
        """Request a picture of the channel whose setting was changed."""
        self._look = self._look.model_copy(update={"channel": channel})
        self.ask(number)

    def compare(self, message: messages.Compare) -> None:
        """Choose a classic filter for comparison with a channel, or none, and request a picture.

        Raises
        ------
        UsageError
            If the filter cannot be compared in this mode.
        """
        desk = self._shared.open_desk
        desk.opened.check_channel(message.channel)
        if message.classic is None:
            self._classics.pop(message.channel, None)
        elif message.classic in desk.classics:
            self._classics[message.channel] = message.classic
        else:
            raise UsageError("That classic filter cannot be compared in this mode; choose one from the list.")
        self.ask(message.number)

    async def map(self, message: messages.Map) -> None:
        """Send the map of how well each noise and density predicts readings."""
        in_thread = self._shared.in_thread
        wanted = await in_thread(lambda: self._wanted(message.number, message.channel))
        await self._wire.send_frame(await in_thread(lambda: map_frame(wanted)))

    def _wanted(self, answers: int, channel: int) -> PictureRequest:
        desk, look = self._shared.open_desk, self._look
        span_s = (
            -math.inf if look.from_s is None else look.from_s,
            math.inf if look.to_s is None else look.to_s,
        )
        classic = self._classics.get(channel)
        if classic not in desk.classics:  # it was chosen in another mode
            classic = None
        recipe, lag = desk.channel(channel), desk.lag
        how = (recipe, lag, span_s, look.width, answers, classic, self.dragging)
        return PictureRequest(desk.opened, channel, *how, setting=desk.setting_message(channel))

    async def _show_newest(self) -> None:
        in_thread, painter = self._shared.in_thread, self._painter
        wanted, shown = self._wanted(self.answers, self._look.channel), self._shown
        if not wanted.hurried and await in_thread(lambda: painter.hurries(wanted)):
            await self._wire.send_frame(
                await in_thread(lambda: painter.picture(wanted._replace(hurried=True)).framed())
            )
            if self._requested.is_set():
                return
        painted = await in_thread(lambda: painter.picture(wanted))
        await self._wire.send_frame(painted.framed())
        if self._requested.is_set():
            return
        if shown.dial != wanted.dial_key:
            await self._wire.send_frame(await in_thread(lambda: dial_frame(wanted)))
            shown.dial = wanted.dial_key
        if wanted.classic is not None and not self._requested.is_set():
            await self._wire.send_frame(await in_thread(lambda: painter.classic(wanted, painted)))
        if not self._requested.is_set():
            await in_thread(lambda: painter.remember(wanted, painted))
        if not (self.dragging or self._requested.is_set() or shown.figures == wanted.judged_key):
            await self._judge(wanted, shown)

    async def _judge(self, wanted: PictureRequest, shown: _Shown) -> None:
        recipe = self._shared.open_desk.recipe_of_all()

        def judge() -> dict[str, Any] | None:
            rows = wanted.opened.rows(wanted.channel)
            return judged(rows, recipe, wanted.recipe, wanted.channel, self._is_quiet)

        figures = await self._shared.in_thread(judge)
        if figures is not None:
            await self._wire.send_message({**figures, "of": wanted.setting})
            shown.figures = wanted.judged_key

    def _is_quiet(self) -> bool:
        return not (self._requested.is_set() or self._wire.gone)
