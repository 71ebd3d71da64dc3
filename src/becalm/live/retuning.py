"""Another recipe amid a stream: asked for by a signal or a page, taken by the thread that filters."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import NamedTuple

from becalm.cleaning.recipe import Recipe
from becalm.errors import BecalmError
from becalm.installation import load_scipy
from becalm.live.stream import Prepared, Stream
from becalm.live.watching.watch import Watch

Heard = Callable[[str | None], object]
"""Is told why a recipe was refused; "" of one that was taken, None of one that a newer one came before."""

Retune = Callable[[Callable[[], Recipe], Heard], None]
"""Asks for another recipe, as `Runner.retune`."""


class _Asked(NamedTuple):
    recipe: Callable[[], Recipe]
    heard: Heard


class Retuning:
    """What was asked for last; what was asked before it and not begun yet is passed over.

    Filters are made in a thread of their own, so that no row waits for them.
    """

    def __init__(self) -> None:
        self._asked: deque[_Asked] = deque()  # so that a signal amid taking loses nothing
        self._making: Future[Prepared] | None = None
        self._heard: Heard = lambda _: None

    def ask(self, recipe: Callable[[], Recipe], heard: Heard) -> None:
        """Ask for a recipe, which is read later."""
        self._asked.append(_Asked(recipe, heard))

    def take(self, stream: Stream, watch: Watch) -> None:
        """Let a stream take filters that are made, unless it is just going from some to others: then later."""
        if self._making is None:
            if self._asked:
                self._begin(stream)
        elif self._making.done() and not stream.gives_way:
            making, self._making = self._making, None
            try:
                stream.take_over(made := making.result())
            except BecalmError as cause:
                self._refuse(str(cause), watch)
            except Exception as cause:  # nobody foresaw it: a stream of weeks shall not end by what was only asked
                self._refuse(f"The recipe could not be taken ({type(cause).__name__}: {cause}).", watch)
            else:
                watch.tuned(made.toml)
                self._heard("")

    def _refuse(self, says: str, watch: Watch) -> None:
        watch.refused(says)
        self._heard(says)

    def _begin(self, stream: Stream) -> None:
        *older, (recipe, self._heard) = (self._asked.popleft() for _ in range(len(self._asked)))
        for one in older:
            one.heard(None)
        making = self._making = Future[Prepared]()

        def make() -> None:
            try:
                making.set_result(stream.prepared(recipe()))
            except Exception as cause:  # the stream's thread says it
                making.set_exception(cause)

        load_scipy()
        threading.Thread(target=make, name="retuning", daemon=True).start()
