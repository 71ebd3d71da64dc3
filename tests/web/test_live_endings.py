"""What of a live page ends, or fails, and what goes on all the same."""

from __future__ import annotations

import asyncio

import numpy as np

from becalm.live.block import Head, Output
from becalm.live.watching.meter import Meter
from becalm.web.livepage import page, session
from becalm.web.livepage.feed import Feed
from live_shown import NAMES, Asked, output_of, recipe_of


def test_a_feed_that_fails_says_so_once_and_the_stream_goes_on() -> None:
    said: list[str] = []
    feed = Feed(said.append)
    feed.write(output_of(0, 10))  # before it was opened
    feed.open(Head(NAMES, ("m", "deg"), 1500.0, recipe_of().to_toml()))
    wrong = np.zeros((10, 3))
    for _ in range(2):
        feed.write(Output(0, np.arange(10.0), wrong, wrong, wrong[:5], np.zeros((10, 3), np.int8)))
    assert len(said) == 1
    assert "the stream goes on" in said[0]
    feed.flush()
    feed.close()
    feed.close()
    assert feed.ended


def test_who_is_let_in_no_more_is_told_no_more() -> None:
    class Watching:
        """A page that only looks on."""

        async def accept(self) -> None: ...

        async def receive(self) -> None:
            await asyncio.Event().wait()

        async def send_text(self, said: str) -> None: ...

    async def end() -> set[str]:
        meter = Meter("replay:drive.csv")
        watched = page.LivePage(Feed(print), meter, Asked(meter).retune)
        watching = asyncio.create_task(session.converse(watched, Watching()))  # type: ignore[arg-type]
        while len(asyncio.all_tasks()) < 6:  # itself, hearing and telling, and two clocks
            await asyncio.sleep(0)
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        await asyncio.sleep(0)
        return {task.get_name() for task in asyncio.all_tasks() if task is not asyncio.current_task()}

    assert asyncio.run(end()) == set()
