"""Change the recipe of a running stream: a signal or a page requests it, the filtering thread applies it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import NamedTuple

from becalm.cleaning.recipes.recipe import Recipe
from becalm.errors import BecalmError
from becalm.installation import load_scipy
from becalm.live.stream import PreparedFilters, Stream
from becalm.live.watching.watch import Watch

RetuneCallback = Callable[[str | None], object]
"""Called with the result: a reason if refused, "" if the recipe is in force, None if a newer request replaced it."""

Retune = Callable[[Callable[[], Recipe], RetuneCallback], None]
"""Requests another recipe: see `Runner.retune`."""


class _Request(NamedTuple):
    recipe: Callable[[], Recipe]
    on_result: RetuneCallback


class Retuning:
    """Collects requests for another recipe, starts only the newest waiting one, and drops the others.

    A separate thread makes the filters, so that no row has to wait.
    """

    def __init__(self) -> None:
        self._requests: deque[_Request] = deque()  # a deque, so that a signal handler may append at any time
        self._making: Future[PreparedFilters] | None = None
        self._on_result: RetuneCallback = lambda _: None

    def ask(self, recipe: Callable[[], Recipe], on_result: RetuneCallback) -> None:
        """Request a recipe; `recipe` is called later and returns it."""
        self._requests.append(_Request(recipe, on_result))

    def apply(self, stream: Stream, watch: Watch) -> None:
        """Start the newest request; once its filters are made and no handover runs, hand the stream over to them."""
        if self._making is None:
            if self._requests:
                self._begin(stream)
        elif self._making.done() and not stream.is_handing_over:
            making, self._making = self._making, None
            try:
                stream.take_over(made := making.result())
            except BecalmError as cause:
                self._refuse(str(cause), watch)
            except Exception as cause:  # unexpected, but a request must not end the stream
                self._refuse(f"The recipe could not be taken ({type(cause).__name__}: {cause}).", watch)
            else:
                watch.record_retuning(made.toml)
                self._on_result("")

    def _refuse(self, message: str, watch: Watch) -> None:
        watch.record_refusal(message)
        self._on_result(message)

    def _begin(self, stream: Stream) -> None:
        *older, (recipe, self._on_result) = (self._requests.popleft() for _ in range(len(self._requests)))
        for one in older:
            one.on_result(None)
        making = self._making = Future[PreparedFilters]()

        def make() -> None:
            try:
                making.set_result(stream.prepare_filters(recipe()))
            except Exception as cause:  # the filtering thread reports it
                making.set_exception(cause)

        load_scipy()
        threading.Thread(target=make, name="retuning", daemon=True).start()
