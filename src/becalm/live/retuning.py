"""Another recipe amid a stream: asked for by a signal or a page, taken by the thread that filters."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from becalm.cleaning.recipe import Recipe
from becalm.errors import BecalmError
from becalm.live.stream import Stream
from becalm.live.watching.watch import Watch

Heard = Callable[[str], object]
"""Is told why a recipe was refused; "" of one that was taken."""

Retune = Callable[[Callable[[], Recipe], Heard], None]
"""Asks for another recipe, as `Runner.retune`."""


class _Asked(NamedTuple):
    recipe: Callable[[], Recipe]
    heard: Heard


class Retuning:
    """What was asked for last; what was asked before it and not taken yet is forgotten."""

    def __init__(self) -> None:
        self._asked: deque[_Asked] = deque(maxlen=1)  # so that a signal amid taking loses nothing

    def ask(self, recipe: Callable[[], Recipe], heard: Heard) -> None:
        """Ask for a recipe, which is read when it is taken."""
        self._asked.append(_Asked(recipe, heard))

    def take(self, stream: Stream, watch: Watch) -> None:
        """Let a stream take what was asked for, unless it is just going from one filter to another: then later."""
        if not self._asked or stream.gives_way:
            return
        asked = self._asked.popleft()
        try:
            recipe = asked.recipe()
            stream.retuned(recipe)
        except BecalmError as cause:
            watch.refused(str(cause))
            asked.heard(str(cause))
        else:
            watch.tuned(recipe.to_toml())
            asked.heard("")
