"""A sink for the live page: it puts rows into bins without waiting for viewers; its errors never end the stream."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from becalm.cleaning.recipes.recipe import Recipe
from becalm.live.block import Head, Output
from becalm.web.livepage.bins import Bins


class StreamData(NamedTuple):
    """The description and the bins of a stream, which the live page shows."""

    head: Head
    bins: Bins
    modes: dict[int, tuple[str, ...]]
    """Names of the modes, by number of the channel, if it has several; probabilities in bins have this order."""


class Feed:
    """A sink that collects the output of a stream, for pages to read from another thread.

    Parameters
    ----------
    say : callable
        Function that prints a sentence if the page stops because of an error.

    Attributes
    ----------
    stream : StreamData or None
        Data of the stream; None before the stream has begun.
    ended : bool
        Whether the stream has ended.
    """

    def __init__(self, say: Callable[[str], object]) -> None:
        self._say = say
        self._failed = False
        self.stream: StreamData | None = None
        self.ended = False

    def open(self, head: Head) -> None:
        """Start a stream with this head."""
        channels = Recipe.from_toml(head.recipe).channel
        modes = {
            number: tuple(mode.name for mode in channel.switching.mode)
            for number, channel in enumerate(channels)
            if channel.switching is not None
        }
        self.stream = StreamData(head, Bins(len(head.names), head.rate_hz, sum(map(len, modes.values()))), modes)

    def write(self, output: Output) -> None:
        """Add some rows in about ten microseconds, whatever the number of viewers; this raises no exception."""
        if self.stream is None or self._failed:
            return
        try:
            self.stream.bins.push(output)
        except Exception as cause:  # an error of the page must not end a stream
            self._failed = True
            self._say(f"The live page stopped ({type(cause).__name__}: {cause}); the stream goes on.")

    def flush(self) -> None:
        """Do nothing: a commit does not wait for viewers."""

    def close(self) -> None:
        """Close the last bins; a second call does nothing."""
        if self.stream is not None and not self.ended:
            self.stream.bins.finish()
        self.ended = True
