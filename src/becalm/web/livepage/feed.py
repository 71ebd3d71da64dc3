"""The sink of a live page: gathers rows in bins at once, waits for nobody and fails nobody."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from becalm.cleaning.recipe import Recipe
from becalm.live.block import Head, Output
from becalm.web.livepage.bins import Bins


class Shown(NamedTuple):
    """A stream as a page shows it."""

    head: Head
    bins: Bins
    modes: dict[int, tuple[str, ...]]
    """Names of the modes of channels that switch; their probabilities come one channel after the other."""


class Feed:
    """Takes what is told of a stream, for pages to read from another thread.

    Parameters
    ----------
    say : callable
        Is given a sentence where a page can be shown no more; the stream goes on.

    Attributes
    ----------
    shown : Shown or None
        Once the stream has begun.
    ended : bool
        Whether no more rows will come.
    """

    def __init__(self, say: Callable[[str], object]) -> None:
        self._say = say
        self._failed = False
        self.shown: Shown | None = None
        self.ended = False

    def open(self, head: Head) -> None:
        """Begin with the first rows of a stream."""
        channels = Recipe.from_toml(head.recipe).channel
        modes = {
            number: tuple(mode.name for mode in channel.switching.mode)
            for number, channel in enumerate(channels)
            if channel.switching is not None
        }
        self.shown = Shown(head, Bins(len(head.names), head.rate_hz, sum(map(len, modes.values()))), modes)

    def write(self, output: Output) -> None:
        """Take some rows; this takes some ten microseconds, however many pages look on, and never fails."""
        if self.shown is None or self._failed:
            return
        try:
            self.shown.bins.push(output)
        except Exception as cause:  # a stream of weeks shall not end by what is there to look at
            self._failed = True
            self._say(f"The live page shows nothing more ({type(cause).__name__}: {cause}); the stream goes on.")

    def flush(self) -> None:
        """Return: nobody need have seen what was written."""

    def close(self) -> None:
        """Close the last bins; harmless twice."""
        if self.shown is not None and not self.ended:
            self.shown.bins.finish()
        self.ended = True
