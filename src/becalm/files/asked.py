"""What a person said of a file, on the command line or by a recipe."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple


class Asker(NamedTuple):
    """Who names columns, for messages.

    Attributes
    ----------
    name : str
        As a sentence begins.
    way_out : str
        What else can be done, as a further sentence.
    """

    name: str
    way_out: str = ""


COMMAND_LINE = Asker("--channels")


@dataclass(frozen=True)
class ReadOptions:
    """What a person said, on the command line or by a recipe.

    Attributes
    ----------
    time : str, optional
        Name of the time column, as in the header or without its unit.
    rate_hz : float, optional
        Rows are counted at this rate; the time column, if any, only passes through.
    channels : tuple of str, optional
        Columns to read, as in the header or without their units; all that look like signals by default.
    asker : Asker
        Who names the channels.
    group : str, optional
        Of a file with several time bases, which of them.
    """

    time: str | None = None
    rate_hz: float | None = None
    channels: tuple[str, ...] | None = None
    asker: Asker = COMMAND_LINE
    group: str | None = None
