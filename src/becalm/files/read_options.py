"""Options for reading a file, from the command line or from a recipe."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from becalm.core.time.clock import FASTEST_HZ, SLOWEST_HZ
from becalm.errors import UsageError

if TYPE_CHECKING:
    from becalm.cleaning.recipes.recipe import Recipe
    from becalm.sensors.record import SensorRecord


class RequestOrigin(NamedTuple):
    """The origin of a request for columns, such as an option or a recipe; used in messages.

    Attributes
    ----------
    name : str
        The subject of sentences in messages, such as "--channels" or "The recipe".
    advice : str
        A sentence that is appended to a message, on what else the user can do. It begins with a space; "" for none.
    """

    name: str
    advice: str = ""


COMMAND_LINE = RequestOrigin("--channels")


class RequiredUnits(NamedTuple):
    """Names and units that channels must have.

    Attributes
    ----------
    origin : RequestOrigin
        The origin of the requirement.
    units : mapping of str to str
        Units by channel name.
    """

    origin: RequestOrigin
    units: Mapping[str, str]


@dataclass(frozen=True)
class ReadOptions:
    """Options for reading a file.

    Attributes
    ----------
    time : str, optional
        Name of the time column, as in the header or without its unit.
    rate_hz : float, optional
        Count rows at this rate in Hz; a time column, if any, is only copied to the output.
    channels : tuple of str, optional
        Columns to read, as in the header or without their units; all that look like signals by default.
    origin : RequestOrigin
        The origin of `channels`, for messages.
    group : str, optional
        The time base to read from a file with several.
    required_units : RequiredUnits, optional
        Names and units that channels must have; a column with the same name in another unit is converted.
    units : mapping of str to str
        Units to convert columns to, by column name as in the header or without its unit.
    sensors : tuple of SensorRecord
        Sensors whose columns are converted to measured quantities before any other conversion.
    as_written : bool
        Keep time stamps as they are: do not put them onto an even grid, and do not correct shifts of an hour.
    """

    time: str | None = None
    rate_hz: float | None = None
    channels: tuple[str, ...] | None = None
    origin: RequestOrigin = COMMAND_LINE
    group: str | None = None
    required_units: RequiredUnits | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    sensors: tuple[SensorRecord, ...] = ()
    as_written: bool = False


def options_of_recipe(recipe: Recipe, again: str) -> ReadOptions:
    """Return the options for reading a file that a recipe will clean: its channels, units and time.

    Parameters
    ----------
    recipe : Recipe
        The recipe.
    again : str
        The command that makes another recipe, for messages.
    """
    origin = RequestOrigin("The recipe", f" Make another recipe with: {again}")
    units = {channel.name: channel.unit for channel in recipe.channel}
    return ReadOptions(
        recipe.time,
        recipe.rate_hz,
        tuple(units),
        origin,
        required_units=RequiredUnits(origin, units),
        as_written=recipe.stamps is not None,
    )


def refuse_impossible(options: ReadOptions) -> None:
    """Refuse a rate that is out of range, or that is combined with stamps as written.

    Raises
    ------
    UsageError
        If the rate is out of range, or both options are given.
    """
    if options.rate_hz is not None and not SLOWEST_HZ <= options.rate_hz <= FASTEST_HZ:
        raise UsageError(f"--rate {options.rate_hz:g} is not a rate; give hertz, {SLOWEST_HZ:g} to {FASTEST_HZ:g}.")
    if options.rate_hz is not None and options.as_written:
        raise UsageError(
            "--rate counts rows instead of reading stamps, and --stamps as-written keeps the stamps; give one of them."
        )
