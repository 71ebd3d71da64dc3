"""From a path to a recording: all of a file at once."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from becalm.core.recording import Recording
from becalm.files.opening import open_source
from becalm.files.read_options import ReadOptions
from becalm.files.source import SourceFile


def read_source(path: str | os.PathLike[str], options: ReadOptions | None = None) -> SourceFile:
    """Read a file of any known format; of several times in it, the one that the options choose.

    Parameters
    ----------
    path : path-like
        The file; its content decides the format.
    options : ReadOptions, optional
        What a person said about time, rate and channels; by default all is found out.

    Returns
    -------
    SourceFile
        The recording, the whole table, and how the file was understood.

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


def read(  # noqa: PLR0913  (what is wanted, each by its name)
    path: str | os.PathLike[str],
    *,
    channels: Sequence[str] | str | None = None,
    rate_hz: float | None = None,
    time: str | None = None,
    units: Mapping[str, str] | None = None,
    as_written: bool = False,
) -> Recording:
    """Read a recording from a file of any known format; of channels at several times, those asked for.

    Parameters
    ----------
    path : path-like
        The file.
    channels : sequence of str, optional
        Columns to read, with or without their units; all that look like signals by default.
    rate_hz : float, optional
        Count rows at this rate instead of reading a time column.
    time : str, optional
        Name of the time column; found by itself where it is clear.
    units : mapping of str to str, optional
        Units to have channels in, by their names, as {"ax": "m/s^2"}; what the file does not tell, they tell.
    as_written : bool
        Keep stamps as they are, where a driver seems to have made them, or summer time to have moved them.

    Raises
    ------
    InputError
        If the file cannot be read, or can be read in more than one way.
    UsageError
        If a column asked for is not there, or cannot be converted.
    """
    asked = (channels,) if isinstance(channels, str) else None if channels is None else tuple(channels)
    with open_source(path, ReadOptions(time, rate_hz, asked, units=units or {}, as_written=as_written)) as source:
        return source.recording()
