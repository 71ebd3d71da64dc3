"""Send the newest picture that a page requests; send the figures of the report, which are slow, after it."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from becalm.errors import UsageError
from becalm.web.tuner import messages
from becalm.web.tuner.judging import judge_channel
from becalm.web.tuner.messages import Look
from becalm.web.tuner.outgoing_messages import Wire
from becalm.web.tuner.painting import Painter, PictureRequest, dial_frame, map_frame

if TYPE_CHECKING:
    from becalm.web.tuner.sharing import Shared

_WIDTH = 2000  # stretches of a picture, until a page sends its own number


@dataclass
class _SentKeys:
    """The keys of the dial and of the figures that were sent last; empty after a new recording is opened."""

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
        Whether the person drags the dial; figures of the report are not sent meanwhile.
    answers : int
        Number of the newest message that the next picture answers.
    """

    def __init__(self, shared: Shared, wire: Wire) -> None:
        self._shared, self._wire = shared, wire
        self._painter = Painter(shared.halves)
        self._look = Look(number=0, do="look", channel=0, width=_WIDTH)
        self._classics: dict[int, str] = {}
        self._requested, self.answers, self._sent = asyncio.Event(), 0, _SentKeys()
        self.dragging = False

    async def run(self) -> None:
        """Send requested pictures, and figures of the report while no picture is requested; this never ends."""
        while True:
            await self._requested.wait()
            self._requested.clear()
            await self._wire.report_errors(self._show_newest, self.answers)

    def reset(self) -> None:
        """Forget the view and the sent keys, because a new recording was opened."""
        self._look = Look(number=0, do="look", channel=0, width=self._look.width)
        self._sent = _SentKeys()
        self._classics.clear()

    def drop_request(self) -> None:
        """Drop the present request."""
        self._requested.clear()

    def request_picture(self, number: int | None = None) -> None:
        """Request a picture, instead of one that has not started yet; `number` is that of a message to answer."""
        self.answers = self.answers if number is None else number
        self._requested.set()

    def look(self, look: Look) -> None:
        """Request a part of a channel."""
        self._shared.current_view_model.opened.check_channel(look.channel)
        self._look = look
        self.request_picture(look.number)

    def show_channel(self, channel: int, number: int) -> None:
        """Request a picture of the channel whose setting was changed."""
        self._look = self._look.model_copy(update={"channel": channel})
        self.request_picture(number)

    def compare(self, message: messages.Compare) -> None:
        """Choose a classic filter for comparison with a channel, or none, and request a picture.

        Raises
        ------
        UsageError
            If the filter cannot be compared in this mode.
        """
        view_model = self._shared.current_view_model
        view_model.opened.check_channel(message.channel)
        if message.classic is None:
            self._classics.pop(message.channel, None)
        elif message.classic in view_model.classics:
            self._classics[message.channel] = message.classic
        else:
            raise UsageError("That classic filter cannot be compared in this mode; choose one from the list.")
        self.request_picture(message.number)

    async def map(self, message: messages.Map) -> None:
        """Send the map of how well each noise and density predicts readings."""
        in_thread = self._shared.in_thread
        wanted = await in_thread(lambda: self._wanted(message.number, message.channel))
        await self._wire.send_frame(await in_thread(lambda: map_frame(wanted)))

    def _wanted(self, answers: int, channel: int) -> PictureRequest:
        view_model, look = self._shared.current_view_model, self._look
        span_s = (
            -math.inf if look.from_s is None else look.from_s,
            math.inf if look.to_s is None else look.to_s,
        )
        classic = self._classics.get(channel)
        if classic not in view_model.classics:  # the classic filter was chosen in another mode
            classic = None
        recipe, lag = view_model.channel(channel), view_model.lag
        how = (recipe, lag, span_s, look.width, answers, classic, self.dragging)
        return PictureRequest(view_model.opened, channel, *how, setting=view_model.setting_message(channel))

    async def _show_newest(self) -> None:
        in_thread, painter = self._shared.in_thread, self._painter
        wanted, sent = self._wanted(self.answers, self._look.channel), self._sent
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
        if sent.dial != wanted.dial_key:
            await self._wire.send_frame(await in_thread(lambda: dial_frame(wanted)))
            sent.dial = wanted.dial_key
        if wanted.classic is not None and not self._requested.is_set():
            await self._wire.send_frame(await in_thread(lambda: painter.classic(wanted, painted)))
        if not self._requested.is_set():
            await in_thread(lambda: painter.remember(wanted, painted))
        if not (self.dragging or self._requested.is_set() or sent.figures == wanted.judged_key):
            await self._judge(wanted, sent)

    async def _judge(self, wanted: PictureRequest, sent: _SentKeys) -> None:
        recipe = self._shared.current_view_model.recipe_of_all()

        def judge() -> dict[str, Any] | None:
            rows = wanted.opened.rows(wanted.channel)
            return judge_channel(rows, recipe, wanted.recipe, wanted.channel, self._is_quiet)

        figures = await self._shared.in_thread(judge)
        if figures is not None:
            await self._wire.send_message({**figures, "of": wanted.setting})
            sent.figures = wanted.judged_key

    def _is_quiet(self) -> bool:
        return not (self._requested.is_set() or self._wire.gone)
