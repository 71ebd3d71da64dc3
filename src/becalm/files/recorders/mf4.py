"""Read MDF files of car loggers (versions 2 to 4): a table for each master channel; CAN logs with DBC files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from datetime import UTC, timedelta
from pathlib import Path
from typing import Any

import pyarrow as pa

from becalm.errors import InputError
from becalm.files.column_statistics import Column, least_bytes
from becalm.files.groups import TIME, Group, tables
from becalm.files.library_reader import LibraryFile
from becalm.files.recorders.mf4_blocks import check_blocks
from becalm.files.recorders.mf4_columns import NO_START, MasterTime, Mf4Channel, columns_of
from becalm.files.source import FormatTime, RawTable
from becalm.files.text.csv_header import unique_names

_VARIABLE_LENGTH, _BUS_EVENT = 1, 2  # bits in the flags of a channel group
_TIME_MASTERS, _INDEX = (0, 1), 4  # synchronisation types of masters; others are angle and distance
_CUT = "The file is incomplete; its complete parts were read."
_MESSAGE = re.compile(r"message (?P<name>\S+) 0x")  # in the comment of a decoded group


def read(path: Path) -> tuple[RawTable, ...]:
    """Read the tables of an MDF file.

    Raises
    ------
    InputError
        If it is damaged, or is a bus log and no DBC file in its folder describes its frames.
    """
    library_file = LibraryFile(path, "MDF")
    library = library_file.library("asammdf")
    with ExitStack() as stack, library_file.explain_damage():
        repairs = check_blocks(library_file)
        file = stack.enter_context(repairs.open_file(path))
        log = library.MDF(file, raise_on_multiple_occurrences=False, add_array_components=False)
        stack.callback(log.close)
        _refuse_outside(log)
        library_file.cut = repairs.cut
        notes = [_CUT] if repairs.cut else []
        buses = [index for index, group in enumerate(log.groups) if _is_bus(group)]
        groups = list(_groups(library_file, log, [index for index in log.virtual_groups if index not in buses]))
        if any(log.groups[index].channel_group.cycles_nr for index in buses):
            decoded, bus_notes = _decoded(library_file, log, bool(groups))
            notes += bus_notes
            if decoded is not None:
                stack.callback(decoded.close)
                groups += _groups(library_file, decoded, list(decoded.virtual_groups))
        notes += [note for one in groups if set(one.columns) <= {TIME} for note in one.notes]  # groups without a table
        held = stack.pop_all()
        return tables(library_file, "mf4", [one._replace(notes=(*one.notes, *notes)) for one in groups], held.close)


def _refuse_outside(log: Any) -> None:
    """Raise an error if a channel (versions 2 and 3) lies outside its rows; asammdf's C code would read beyond them."""
    for group in log.groups if log.version < "4" else ():
        for channel in group.channels:
            stop = 8 * getattr(channel, "additional_byte_offset", 0) + channel.start_offset + channel.bit_count
            if stop > 8 * group.channel_group.samples_byte_nr:
                raise ValueError(f"the channel {channel.name!r} lies outside its rows")


def _is_bus(group: Any) -> bool:
    return bool(getattr(group.channel_group, "flags", 0) & _BUS_EVENT)


def _decoded(library_file: LibraryFile, log: Any, more: bool) -> tuple[Any, list[str]]:
    """Decode the frames of a bus with the DBC files in the log's folder.

    If that fails, return None and the reason if there are `more` groups, otherwise raise an InputError.
    """
    path = library_file.path
    databases = sorted(one for one in path.parent.iterdir() if one.suffix.lower() == ".dbc")
    why = f"{path} is a log of a CAN bus; put the .dbc file that describes its frames into the same folder."
    if databases:
        decoded = log.extract_bus_logging(database_files={"CAN": [(str(one), 0) for one in databases]})
        if decoded.groups:
            return decoded, []
        decoded.close()
        names = ", ".join(one.name for one in databases)
        why = (
            f"{path} is a log of a CAN bus whose frames {names} does not describe; put the .dbc file that does into the"
            " same folder."
        )
    if not more:
        raise InputError(why)
    return None, [why]


def _groups(library_file: LibraryFile, log: Any, masters: Sequence[int]) -> Iterator[Group]:
    for index in masters:
        group = log.groups[index].channel_group
        rows = min(
            log.virtual_groups[index].cycles_nr, *(_rows(log.groups[one]) for one in log.virtual_groups[index].groups)
        )
        if not rows or getattr(group, "flags", 0) & _VARIABLE_LENGTH:
            continue
        promised = log.virtual_groups[index].cycles_nr
        notes = [] if rows == promised else [f"Of {promised} rows {rows} are whole and were read."]
        named: list[tuple[str, Column]] = []
        for one, numbers in log.included_channels(index)[index].items():
            for number in numbers:
                read_columns, note = columns_of(library_file, Mf4Channel(log, one, number))
                named += read_columns
                notes += note
        master, time = _master(log, index)
        names = unique_names([*master, *(name for name, _ in named)])
        columns = dict(zip(names, [*master.values(), *(column for _, column in named)], strict=True))
        library_file.refuse_claim(rows * sum(least_bytes(column.type) for column in columns.values()))
        yield Group(_title(group), columns, rows, time, tuple(notes))


def _rows(group: Any) -> int:
    """Return the number of complete rows in the data blocks of a group."""
    head = group.channel_group
    invalidation = 0 if getattr(group, "uses_ld", False) else getattr(head, "invalidation_bytes_nr", 0)
    width = head.samples_byte_nr + invalidation
    if not width:  # the group has only a virtual master, which counts rows
        return int(head.cycles_nr)
    blocks = group.get_data_blocks() if hasattr(group, "get_data_blocks") else ()
    return int(sum(block.original_size for block in blocks) // width)


def _master(log: Any, index: int) -> tuple[dict[str, Column], FormatTime | None]:
    """Return the column of a group's master, and its time if the master is a time."""
    number = log.masters_db.get(index)
    if number is None:
        return {}, None
    channel = log.groups[index].channels[number]
    if getattr(channel, "sync_type", 1) == _INDEX:  # a row number, not a time
        return {}, None
    if getattr(channel, "sync_type", 1) not in _TIME_MASTERS:
        angle = Column(
            pa.float64(), lambda first, last: log.get_master(index, record_offset=first, record_count=last - first)
        )
        return {channel.name: angle._replace(unit=channel.unit)}, None
    time = MasterTime(Mf4Channel(log, index, number))
    start = ""
    if str(getattr(log.groups[index].channel_group, "comment", "")) == NO_START:
        return {TIME: Column(pa.float64(), time.read, "s")}, FormatTime(TIME)
    with suppress(Exception):  # an invalid date is not a reason to reject the file
        start = _instant(log, time.first_s)
    return {TIME: Column(pa.float64(), time.read, "s")}, FormatTime(TIME, None, start)


def _instant(log: Any, after_s: float) -> str:
    began = log.header.start_time
    if began.year <= 1970:  # not set
        return ""
    if began.tzinfo is None:
        return str((began + timedelta(seconds=after_s)).isoformat())
    return f"{(began + timedelta(seconds=after_s)).astimezone(UTC).replace(tzinfo=None).isoformat()}Z"


def _title(group: Any) -> str:
    comment = str(getattr(group, "comment", "") or "")
    if found := _MESSAGE.search(comment):
        return found["name"]
    name = str(getattr(group, "acq_name", "") or "")
    return name or ("" if "<" in comment else comment.strip())
