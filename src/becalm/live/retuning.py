"""Change the recipe of a running stream: a signal or a page requests it, the filtering thread takes it."""

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
"""Called with the result: why the recipe was refused, "" if it was taken, None if a newer request replaced it."""

Retune = Callable[[Callable[[], Recipe], Heard], None]
"""Requests another recipe: see `Runner.retune`."""


class _Request(NamedTuple):
    recipe: Callable[[], Recipe]
    heard: Heard


class Retuning:
    """Takes requests for another recipe, and starts only the newest of those that wait; it drops the others.

    A separate thread makes the filters, so that no row has to wait.
    """

    def __init__(self) -> None:
        self._requests: deque[_Request] = deque()  # a deque, so that a signal handler may append at any time
        self._making: Future[Prepared] | None = None
        self._heard: Heard = lambda _: None

    def ask(self, recipe: Callable[[], Recipe], heard: Heard) -> None:
        """Request a recipe; `recipe` is called later and returns it."""
        self._requests.append(_Request(recipe, heard))

    def take(self, stream: Stream, watch: Watch) -> None:
        """Start the newest request; hand the stream over to its filters once they are made and no handover runs."""
        if self._making is None:
            if self._requests:
                self._begin(stream)
        elif self._making.done() and not stream.gives_way:
            making, self._making = self._making, None
            try:
                stream.take_over(made := making.result())
            except BecalmError as cause:
                self._refuse(str(cause), watch)
            except Exception as cause:  # unexpected, but a request must not end the stream
                self._refuse(f"The recipe could not be taken ({type(cause).__name__}: {cause}).", watch)
            else:
                watch.tuned(made.toml)
                self._heard("")

    def _refuse(self, message: str, watch: Watch) -> None:
        watch.refused(message)
        self._heard(message)

    def _begin(self, stream: Stream) -> None:
        *older, (recipe, self._heard) = (self._requests.popleft() for _ in range(len(self._requests)))
        for one in older:
            one.heard(None)
        making = self._making = Future[Prepared]()

        def make() -> None:
            try:
                making.set_result(stream.prepared(recipe()))
            except Exception as cause:  # the filtering thread reports it
                making.set_exception(cause)

        load_scipy()
        threading.Thread(target=make, name="retuning", daemon=True).start()
