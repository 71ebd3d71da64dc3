"""Read a whole file into memory as a recording."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from becalm.core.recording import Recording
from becalm.files.opening import open_source
from becalm.files.read_options import ReadOptions
from becalm.files.source import SourceFile


def read_source(path: str | os.PathLike[str], options: ReadOptions | None = None) -> SourceFile:
    """Read a file of any known format; if it has several time bases, the one that the options select.

    Parameters
    ----------
    path : path-like
        The file; its content decides the format.
    options : ReadOptions, optional
        Time, rate and channels that the user gives; by default they are found in the file.

    Returns
    -------
    SourceFile
        The recording, the whole table, and how the file was interpreted.

    Raises
    ------
    InputError
        If the file cannot be read, or can be read in more than one way.
    UsageError
        If the options do not fit the file.
    """
    with open_source(path, options) as source:
        table = source.table()
        return SourceFile(source.recording(), table, source.layout)


def read(  # noqa: PLR0913  (options, all passed by name)
    path: str | os.PathLike[str],
    *,
    channels: Sequence[str] | str | None = None,
    rate_hz: float | None = None,
    time: str | None = None,
    units: Mapping[str, str] | None = None,
    as_written: bool = False,
) -> Recording:
    """Read a recording from a file of any known format; `channels` selects one of several time bases.

    Parameters
    ----------
    path : path-like
        The file.
    channels : sequence of str, optional
        Columns to read, with or without their units; all that look like signals by default.
    rate_hz : float, optional
        Count rows at this rate in Hz instead of reading a time column.
    time : str, optional
        Name of the time column; by default it is found if there is only one candidate.
    units : mapping of str to str, optional
        Units to convert channels to, by channel name, as {"ax": "m/s^2"}. For a channel without a unit in the file,
        the given unit is assumed.
    as_written : bool
        Keep time stamps as they are. By default, stamps that a driver seems to have invented and shifts by summer
        time are corrected.

    Raises
    ------
    InputError
        If the file cannot be read, or can be read in more than one way.
    UsageError
        If a requested column is missing, or cannot be converted.
    """
    names = (channels,) if isinstance(channels, str) else None if channels is None else tuple(channels)
    with open_source(path, ReadOptions(time, rate_hz, names, units=units or {}, as_written=as_written)) as source:
        return source.recording()
