"""Read ULog files of PX4 autopilots; each topic and sensor instance has its own stamps."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.core.arrays import Integers
from becalm.files.column_statistics import NO_UNIT, Column
from becalm.files.groups import TIME, Group, tables
from becalm.files.libraries.bounded_file import BoundedFile
from becalm.files.library_reader import LibraryFile
from becalm.files.robots.topics import shorten_list
from becalm.files.source import FormatTime, RawTable
from becalm.files.text.csv_header import unique_names
from becalm.files.timing.integer_stamps import in_order, seconds_of

_STAMP = ("uint64_t", 0, "timestamp")  # the field of stamps in a format: type, length of a list, and name
_PADDING = "_padding"  # beginning of the names of fields without content
_MOST_BYTES = 0xFFFF  # largest message in bytes, and so the largest number of its fields
_MOST_FIELDS = 500_000  # largest number of fields in all logged topics; each takes some hundred bytes in pyulog
_PER_SECOND = 1_000_000  # stamps are in microseconds


def read(path: Path) -> tuple[RawTable, ...]:
    """Read a log: a table for each topic and instance; time runs from the start of the log.

    Raises
    ------
    InputError
        If it is damaged, or holds no messages.
    """
    library_file = LibraryFile(path, "ULog")
    library = library_file.library("pyulog")
    with library_file.explain_damage(), path.open("rb") as file:
        opened = BoundedFile(file)
        heading = library.ULog(_KeptOpen(opened), parse_header_only=True)
        sizes = _sizes(library_file, heading.message_formats)
        opened.seek(0)
        stamped = [name for name, one in heading.message_formats.items() if _STAMP in one.fields]
        reader = _bounded(library_file, library, sizes)
        log = reader(_KeptOpen(opened), stamped)  # without the list, it stops at the first message without a stamp
        notes = _notes(log, opened, _unstamped(log, stamped))
        groups = [_group(topic, log.start_timestamp, notes) for topic in log.data_list]
    return tables(library_file, "ulog", groups)


class _KeptOpen:
    """A file that its reader cannot close."""

    def __init__(self, file: BoundedFile) -> None:
        self.read, self.seek, self.tell = file.read, file.seek, file.tell

    def close(self) -> None:
        """Do nothing, so that the file stays open."""


def _sizes(library_file: LibraryFile, formats: dict[str, Any]) -> dict[str, int]:
    """Count the fields of each format; reject recursive formats, and those with more fields than a message's bytes."""
    sizes: dict[str, int] = {}

    def size(name: str, within: tuple[str, ...]) -> int:
        if name not in formats:
            return 1  # a number, or an unknown type, which the library reports
        if name in within:
            raise library_file.damage_error(f"the format {name} contains itself")
        if name not in sizes:
            held = (max(1, count) * size(kind, (*within, name)) for kind, count, _ in formats[name].fields)
            sizes[name] = sum(held)
        if sizes[name] > _MOST_BYTES:
            raise library_file.damage_error(
                f"the format {name} has {sizes[name]:,} fields, but a message has at most {_MOST_BYTES:,} bytes"
            )
        return sizes[name]

    for name in formats:
        size(name, ())
    return sizes


def _bounded(library_file: LibraryFile, library: ModuleType, sizes: dict[str, int]) -> Any:
    """Return the library's reader with a limit on the fields of all topics, as it makes an object per field."""
    original, left = library.ULog._MessageAddLogged, _MOST_FIELDS

    def subscribed(data: bytes, header: Any, formats: dict[str, Any]) -> Any:
        nonlocal left
        left -= sizes.get(library.ULog.parse_string(data[3:]), 0)
        if left < 0:
            raise library_file.damage_error(f"its topics have more than {_MOST_FIELDS:,} fields in all")
        return original(data, header, formats)

    return type("_Bounded", (library.ULog,), {"_MessageAddLogged": staticmethod(subscribed)})


def _unstamped(log: Any, stamped: list[str]) -> list[str]:
    """Return the formats whose messages have no stamp, except those that are parts of other formats."""
    parts = {kind for one in log.message_formats.values() for kind, _, _ in one.fields}
    return sorted(set(log.message_formats) - set(stamped) - parts)


def _notes(log: Any, opened: BoundedFile, unstamped: list[str]) -> tuple[str, ...]:
    notes = []
    if log.file_corruption:
        notes.append("Parts of the file are damaged; the messages that are whole were read.")
    elif opened.cut:
        notes.append("The file ends in the middle of a message; those before it were read.")
    if unstamped:
        notes.append(f"Left out, because their messages have no timestamp: {shorten_list(unstamped)}.")
    if log.dropouts:
        lost_s = sum(dropout.duration for dropout in log.dropouts) / 1000.0
        times = "once" if len(log.dropouts) == 1 else f"{len(log.dropouts):,} times"
        notes.append(f"The logger lost messages {times}, for {lost_s:g} s in all.")
    return tuple(notes)


def _group(topic: Any, start: int, notes: tuple[str, ...]) -> Group:
    """Return a group of a topic's fields without padding; the stamp is the time."""
    fields = _fields(topic)
    rows = len(next(iter(topic.data.values())))
    name = f"{topic.name}_{topic.multi_id}"
    ordered = in_order(_signed(fields.pop(_STAMP[2])))
    titles = unique_names((TIME, *fields))
    time = seconds_of(ordered.stamps, _PER_SECOND, int(_signed(np.array([start], np.uint64))[0]))
    columns = {TIME: Column.of(time, "s")}
    for title, values in zip(titles[1:], fields.values(), strict=True):
        columns[title] = _column(values if ordered.order is None else values[ordered.order])
    return Group(name, columns, rows, FormatTime(TIME), (*notes, *ordered.notes))


def _signed(stamps: NDArray[Any]) -> Integers:
    return stamps.astype(np.uint64).view(np.int64)


def _column(values: NDArray[Any]) -> Column:
    """Return a column of numbers, flags or texts."""
    if values.dtype.kind == "S":
        texts = values
        return Column(pa.string(), lambda start, stop: _decoded(texts[start:stop]), NO_UNIT)
    return Column.of(values, NO_UNIT)


def _decoded(texts: NDArray[np.bytes_]) -> NDArray[np.object_]:
    return np.array([text.decode("utf-8", "replace") for text in texts.tolist()], object)


def _fields(topic: Any) -> dict[str, NDArray[Any]]:
    """Return the values of all fields; flags become bool, and arrays of characters become texts."""
    fields: dict[str, NDArray[Any]] = {}
    texts: dict[str, list[NDArray[Any]]] = {}
    for field in topic.field_data:
        name, values = field.field_name, topic.data[field.field_name]
        if name.rpartition(".")[2].startswith(_PADDING):
            continue
        if field.type_str == "char":
            texts.setdefault(name.rpartition("[")[0] or name, []).append(values)
            fields.setdefault(name.rpartition("[")[0] or name, values)
        else:
            fields[name] = values != 0 if field.type_str == "bool" else values
    for name, characters in texts.items():
        rows = np.ascontiguousarray(np.stack(characters, axis=1))
        fields[name] = rows.view(f"S{len(characters)}").reshape(-1)
    return fields
