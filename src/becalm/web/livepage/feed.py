"""A sink for the live page: it puts rows into bins without waiting for viewers; its errors never end the stream."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from becalm.cleaning.recipe import Recipe
from becalm.live.block import Head, Output
from becalm.web.livepage.bins import Bins


class Shown(NamedTuple):
    """The data of a stream for its pages."""

    head: Head
    bins: Bins
    modes: dict[int, tuple[str, ...]]
    """Names of the modes of each channel with several, by its number; probabilities have the same order."""


class Feed:
    """A sink that collects the output of a stream, for pages to read from another thread.

    Parameters
    ----------
    say : callable
        Function that prints a sentence if the page stops because of an error.

    Attributes
    ----------
    shown : Shown or None
        Data of the stream; None before it has begun.
    ended : bool
        Whether the stream has ended.
    """

    def __init__(self, say: Callable[[str], object]) -> None:
        self._say = say
        self._failed = False
        self.shown: Shown | None = None
        self.ended = False

    def open(self, head: Head) -> None:
        """Start a stream with this head."""
        channels = Recipe.from_toml(head.recipe).channel
        modes = {
            number: tuple(mode.name for mode in channel.switching.mode)
            for number, channel in enumerate(channels)
            if channel.switching is not None
        }
        self.shown = Shown(head, Bins(len(head.names), head.rate_hz, sum(map(len, modes.values()))), modes)

    def write(self, output: Output) -> None:
        """Add some rows in about ten microseconds, whatever the number of viewers; this never fails."""
        if self.shown is None or self._failed:
            return
        try:
            self.shown.bins.push(output)
        except Exception as cause:  # an error of the page must not end a stream
            self._failed = True
            self._say(f"The live page stopped ({type(cause).__name__}: {cause}); the stream goes on.")

    def flush(self) -> None:
        """Do nothing: viewers need not have seen the rows."""

    def close(self) -> None:
        """Close the last bins; a second call does nothing."""
        if self.shown is not None and not self.ended:
            self.shown.bins.finish()
        self.ended = True
