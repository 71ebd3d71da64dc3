"""Read IDE files of enDAQ (Mide) shock and vibration recorders; each channel has its own time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.core.arrays import Floats
from becalm.files.column_statistics import NO_UNIT, Column
from becalm.files.groups import TIME, Group, tables
from becalm.files.libraries.bounded_file import BoundedFile
from becalm.files.library_reader import LibraryFile
from becalm.files.source import FormatTime, RawTable
from becalm.files.text.csv_header import unique_names
from becalm.files.timing.integer_stamps import instant

_MICROSECOND_S = 1e-6  # in seconds; the library gives times in microseconds


def read(path: Path) -> tuple[RawTable, ...]:
    """Read a recording: a table for each channel and session, calibrated by the polynomials in the file.

    Raises
    ------
    InputError
        If it is damaged, or holds no samples.
    """
    library_file = LibraryFile(path, "IDE")
    library = library_file.library("idelib.importer")
    with library_file.explain_damage(), path.open("rb") as file:
        opened = BoundedFile(file)
        recording = library.openFile(opened, quiet=True)
        notes = _cut_off(recording.ebmldoc, opened)
        library.readData(recording)  # loads all blocks undecoded; they are decoded when their rows are read
        groups = _groups(recording, notes)
    return tables(library_file, "ide", groups)


def _cut_off(document: Any, opened: BoundedFile) -> tuple[str, ...]:
    """End the file after its last complete element, since the library rejects truncated files; return a note if cut."""
    whole = 0
    with suppress(Exception):  # the library raises many types for a damaged element; those before it are complete
        for element in document:
            end = element.payloadOffset + element.size
            if end > opened.size:
                break
            whole = end
    if whole == opened.size:
        return ()
    opened.size = whole
    return ("The file is damaged or ends too early; the blocks before that were read.",)


def _groups(recording: Any, notes: tuple[str, ...]) -> list[Group]:
    names = Counter(channel.name for channel in recording.channels.values())
    return [
        _group(channel, f" (channel {channel.id})" if names[channel.name] > 1 else "", events, notes)
        for channel in recording.channels.values()
        for events in channel.sessions.values()
        if len(events)
    ]


def _group(channel: Any, which: str, events: Any, notes: tuple[str, ...]) -> Group:
    samples = _Samples(events)
    titles = unique_names((TIME, *(part.displayName for part in channel.subchannels)))
    columns = {TIME: Column(pa.float64(), samples.seconds, "s")}
    for place, (title, part) in enumerate(zip(titles[1:], channel.subchannels, strict=True), start=1):
        columns[title] = Column(pa.float64(), samples.row(place), part.units[1] or NO_UNIT)
    return Group(channel.name + which, columns, len(events), FormatTime(TIME, start=_start(events, samples)), notes)


def _start(events: Any, samples: _Samples) -> str:
    """Return the instant of the first sample, or "" if the recorder's clock was not set."""
    utc_s = events.session.utcStartTime
    return instant(np.array([int((utc_s + samples.seconds(0, 1)[0]) * 1e6) * 1000])) if utc_s else ""


class _Samples:
    """The samples of one channel; each block of rows is decoded once for all columns.

    Parameters
    ----------
    events : idelib.dataset.EventArray
        Its `arraySlice` returns the times in microseconds as the first row, then a row for each subchannel.
    """

    def __init__(self, events: Any) -> None:
        self._events = events
        self._where, self._held = (0, 0), np.empty((0, 0))

    def _decoded(self, start: int, stop: int) -> Floats:
        if self._where != (start, stop):
            self._held, self._where = self._events.arraySlice(start, stop), (start, stop)
        return self._held

    def seconds(self, start: int, stop: int) -> Floats:
        """Return the times of rows on the recorder's clock, in seconds."""
        seconds: Floats = self._decoded(start, stop)[0] * _MICROSECOND_S
        return seconds

    def row(self, place: int) -> Callable[[int, int], NDArray[np.generic]]:
        """Return a function that reads row `place` of the array: the times, or one subchannel."""
        return lambda start, stop: self._decoded(start, stop)[place]
