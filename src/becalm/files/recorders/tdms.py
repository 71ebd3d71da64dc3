"""Read TDMS files of LabVIEW and DIAdem; the time comes from waveform properties or from a channel of times."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.files.column_statistics import Column, least_bytes
from becalm.files.groups import GROUP, START, TIME, Group, tables
from becalm.files.library_reader import LibraryFile
from becalm.files.recorders.tdms_writer import FILL
from becalm.files.source import FormatTime, RawTable
from becalm.files.timing.time_column import is_time_name
from becalm.files.units.unit_spelling import tidy_unit

_LEAD_IN = struct.Struct("<4siiQQ")  # of a segment: tag, flags, version, length after this, length of metadata
_UNFINISHED = 0xFFFFFFFFFFFFFFFF  # length of a segment that the recorder did not finish
_BIG_ENDIAN = 1 << 6  # flag of a segment
_HELD_BYTES = 1 << 22  # most bytes of a channel that are held in memory
_PRESET_S = 1.0  # default time step of LabVIEW; a channel of times in the same group is more reliable
_NOT_SET_BEFORE = np.datetime64("1905-01-01")  # TDMS times count from 1904; an earlier start was not set


class _TimeBase(NamedTuple):
    """The properties that channels with the same time share."""

    rows: int  # number of rows of a complete file
    time: FormatTime | None


def read(path: Path) -> tuple[RawTable, ...]:
    """Read the tables of a TDMS file.

    Raises
    ------
    InputError
        If it is damaged, or holds no channel of numbers.
    """
    library_file = LibraryFile(path, "TDMS")
    library = library_file.library("nptdms")
    file = path.open("rb")  # an open file, so that npTDMS does not use an index file, which may be outdated
    try:
        with library_file.explain_damage():
            held = library.TdmsFile.open(file, raw_timestamps=True)
            status = held.file_status
            missing = {
                name: one.expected_length - one.read_length
                for name, one in ((status.channel_statuses or {}) if status.incomplete_final_segment else {}).items()
            }
            groups = [one for group in held.groups() for one in _groups(library_file, group, missing)]
            if status.incomplete_final_segment or not _ends_whole(path):
                groups = [one._replace(notes=(*one.notes, _cut(one.rows))) for one in groups]
            return tables(library_file, "tdms", groups, file.close)
    except BaseException:
        file.close()
        raise


def _cut(rows: int) -> str:
    return f"The file ends in the middle of a segment; {rows} rows are whole and were read."


def _ends_whole(path: Path) -> bool:
    """Return whether the last segment is as long as it claims."""
    size, at = path.stat().st_size, 0
    with path.open("rb") as file:
        while at + _LEAD_IN.size <= size:
            file.seek(at)
            lead = file.read(_LEAD_IN.size)
            _, mask, _, length, _ = _LEAD_IN.unpack(lead)
            if mask & _BIG_ENDIAN:
                length = struct.unpack_from(">Q", lead, 12)[0]
            if length == _UNFINISHED:
                return False
            at += _LEAD_IN.size + length
    return at == size


def _groups(library_file: LibraryFile, group: Any, missing: dict[str, int]) -> Iterator[Group]:
    """Yield a table for each time base in a group."""
    held: dict[_TimeBase, list[Any]] = {}
    empty = [channel.name for channel in group.channels() if not len(channel)]
    clocks = {len(channel) for channel in group.channels() if is_time_name(channel.name)}
    name, start = (str(group.properties.get(key, other)) for key, other in ((GROUP, group.name), (START, "")))
    dated = FormatTime(TIME, None, start) if start and TIME in {channel.name for channel in group.channels()} else None
    for channel in group.channels():
        if len(channel):
            preset = len(channel) in clocks and channel.properties.get("wf_increment") == _PRESET_S
            time = dated if preset or dated else _waveform_time(channel.properties)
            base = _TimeBase(len(channel) + missing.get(channel.path, 0), time)
            held.setdefault(base, []).append(channel)
    # Channels without a time get the time of waveforms with as many rows, if these waveforms have the same time.
    for base in [base for base in held if base.time is None]:
        timed = [other for other in held if other.time is not None and other.rows == base.rows]
        if len(timed) == 1:
            order = {channel.path: number for number, channel in enumerate(group.channels())}
            held[timed[0]] = sorted(held[timed[0]] + held.pop(base), key=lambda channel: order[channel.path])
    for base, members in held.items():
        rows = min(len(channel) for channel in members)
        columns: dict[str, Column] = {}
        notes = [f"{name!r} has no rows, and was left out." for name in empty]
        for channel in members:
            own = dict(_columns(channel))
            if not own:
                notes.append(f"{channel.name!r} holds values of an unknown type, and was left out.")
            columns |= own
        library_file.refuse_claim(rows * sum(least_bytes(column.type) for column in columns.values()))
        yield Group(name, columns, rows, base.time, tuple(notes))


def _waveform_time(properties: dict[str, Any]) -> FormatTime | None:
    """Return rate and start of a waveform, or None if its properties do not contain them."""
    step_s = properties.get("wf_increment")
    if not isinstance(step_s, float | int) or not 0.0 < step_s < np.inf:
        return None
    if tidy_unit(str(properties.get("wf_xunit_string", "s"))) not in ("", "s"):  # a spectrum
        return None
    start, offset = properties.get("wf_start_time"), properties.get("wf_start_offset", 0.0)
    if start is None or not hasattr(start, "as_datetime64"):
        return FormatTime(rate_hz=1.0 / step_s)
    first = start.as_datetime64("us") + np.timedelta64(round(float(offset) * 1e6), "us")
    return FormatTime(rate_hz=1.0 / step_s, start="" if first < _NOT_SET_BEFORE else f"{first}Z")


def _columns(channel: Any) -> Iterator[tuple[str, Column]]:
    """Yield the columns of a channel: one, or two for complex values, or none for an unknown type."""
    kind = np.dtype(channel.dtype).newbyteorder("=")
    unit, fill = _unit(channel.properties), channel.properties.get(FILL)
    if kind.kind in "iu" and fill is not None:

        def with_missing(values: NDArray[Any]) -> NDArray[Any]:
            return np.ma.masked_array(values.astype(kind), values == fill)

        yield channel.name, Column(pa.from_numpy_dtype(kind), _reader(channel, with_missing), unit)
        return
    if kind.kind in "iufb":
        yield (
            channel.name,
            Column(pa.from_numpy_dtype(kind), _reader(channel, lambda values: values.astype(kind)), unit),
        )
    elif kind.kind == "c":
        for part in ("real", "imag"):
            of_part = _reader(channel, lambda values, part=part: getattr(values, part).astype(np.float64))  # type: ignore[misc]
            yield f"{channel.name}_{part}", Column(pa.float64(), of_part, unit)
    elif kind.kind == "M":
        yield channel.name, Column(pa.timestamp("ns"), _reader(channel, lambda stamps: stamps.as_datetime64("ns")))
    elif kind.kind == "O":
        yield channel.name, Column(pa.string(), _reader(channel, np.asarray))


def _unit(properties: dict[str, Any]) -> str:
    return next((str(properties[name]) for name in ("unit_string", "NI_UnitDescription") if name in properties), "")


def _reader(channel: Any, tidy: Callable[[Any], NDArray[np.generic]]) -> Callable[[int, int], NDArray[np.generic]]:
    held: Any = None

    def read_rows(first: int, last: int) -> NDArray[np.generic]:
        nonlocal held
        if held is None:
            held = _values(channel)
        values = tidy(held[first:last])
        if len(values) != last - first:
            raise ValueError(f"{channel.name} has {first + len(values)} values, not {len(channel)}")
        return values

    return read_rows


def _values(channel: Any) -> Any:
    """Return all values of a channel, from a temporary file if they are large: npTDMS reads a chunk for each slice."""
    kind = np.dtype(channel.dtype)
    if kind.kind not in "iufbc" or len(channel) * kind.itemsize <= _HELD_BYTES:
        return channel[:]
    at = 0
    with TemporaryFile() as file:  # the array keeps the content after the file is closed
        values = np.memmap(file, kind, "w+", shape=(len(channel),))
    for chunk in channel.data_chunks():
        values[at : at + len(chunk)] = chunk[:]
        at += len(chunk)
    return values[:at]
