"""Options of reading a file, from the command line or a recipe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from becalm.core.time.clock import FASTEST_HZ, SLOWEST_HZ
from becalm.errors import UsageError
from becalm.sensors.record import SensorRecord

if TYPE_CHECKING:
    from becalm.cleaning.recipe import Recipe


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


class Fitting(NamedTuple):
    """What channels are to be like.

    Attributes
    ----------
    asker : Asker
        Who needs it.
    units : mapping of str to str
        Units by names of channels.
    """

    asker: Asker
    units: Mapping[str, str]


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
    fitting : Fitting, optional
        Names and units that channels are to have; those of the same bare name in others are converted.
    units : mapping of str to str
        Units to have columns in, by their names as in the header or without their units.
    sensors : tuple of SensorRecord
        What columns are turned into before that.
    as_written : bool
        Whether stamps stay as they are, where they would be put onto an even grid, or hours undone.
    """

    time: str | None = None
    rate_hz: float | None = None
    channels: tuple[str, ...] | None = None
    asker: Asker = COMMAND_LINE
    group: str | None = None
    fitting: Fitting | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    sensors: tuple[SensorRecord, ...] = ()
    as_written: bool = False


def asked_by(recipe: Recipe, again: str) -> ReadOptions:
    """Return what a recipe asks of a file.

    Parameters
    ----------
    recipe : Recipe
        Of the channels to read.
    again : str
        What to type for another recipe.
    """
    asker = Asker("The recipe", f" Make another recipe with: {again}")
    units = {channel.name: channel.unit for channel in recipe.channel}
    return ReadOptions(
        recipe.time,
        recipe.rate_hz,
        tuple(units),
        asker,
        fitting=Fitting(asker, units),
        as_written=recipe.stamps is not None,
    )


def refuse_impossible(options: ReadOptions) -> None:
    """Refuse a rate that was said and is none, or beside stamps that are to stay.

    Raises
    ------
    UsageError
        If it is out of range, or both are asked.
    """
    if options.rate_hz is not None and not SLOWEST_HZ <= options.rate_hz <= FASTEST_HZ:
        raise UsageError(f"--rate {options.rate_hz:g} is not a rate; give hertz, {SLOWEST_HZ:g} to {FASTEST_HZ:g}.")
    if options.rate_hz is not None and options.as_written:
        raise UsageError(
            "--rate counts rows in place of their stamps, and --stamps as-written keeps these; ask for one of them."
        )
