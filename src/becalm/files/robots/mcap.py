"""Read MCAP files with messages of ROS 1, ROS 2 or JSON in the order of the file, also truncated ones."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from becalm.files.groups import tables
from becalm.files.libraries.bounded_file import BoundedFile, bounded_bytes
from becalm.files.libraries.unpacking import unpacked
from becalm.files.library_reader import LibraryFile
from becalm.files.robots.ros_messages import IDL, MSG, Schema
from becalm.files.robots.topics import Message, collect_groups
from becalm.files.source import RawTable

_MAGIC_BYTES = 8  # size of the signature at the start of the file
_HEAD_BYTES, _CHUNK = 9, b"\x06"  # size of a record's header (opcode and length), and the opcode of a chunk


def read(path: Path) -> tuple[RawTable, ...]:
    """Read a log: a table for each topic.

    Raises
    ------
    InputError
        If it is damaged, or holds no numbers.
    """
    library_file = LibraryFile(path, "MCAP")
    library_file.library("mcap.stream_reader")
    with library_file.explain_damage(), path.open("rb") as file:
        log = McapLog(library_file, BoundedFile(file))
        groups = collect_groups(library_file, log.messages(), log.notes)
    return tables(library_file, "mcap", groups)


class McapLog:
    """An MCAP file.

    Parameters
    ----------
    library_file : LibraryFile
        The file or folder that the user named, for messages.
    file : BoundedFile
        The file, at its start.
    """

    def __init__(self, library_file: LibraryFile, file: BoundedFile) -> None:
        self._library_file, self._file = library_file, file
        self._library = library_file.library("mcap.stream_reader")
        self._records = library_file.library("mcap.records")
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, tuple[str, Schema]] = {}
        self._ended = False
        self._damaged = 0

    def notes(self) -> tuple[str, ...]:
        """Return notes on the file; call this after the last message."""
        notes = []
        if not self._ended:
            notes.append("The file has no end, as if recording or copying was cut off; what is whole was read.")
        if self._damaged:
            notes.append(f"Damaged parts of the file were left out: {self._damaged:,}.")
        return tuple(notes)

    def messages(self) -> Iterator[Message]:
        """Yield the messages in the order of the file."""
        self._file.seek(_MAGIC_BYTES)
        for record in self._intact_records(self._file):
            if isinstance(record, self._records.DataEnd):
                self._ended = True
                return
            if isinstance(record, self._records.Chunk):
                data = self._chunk(record)
                for inner in () if data is None else self._intact_records(bounded_bytes(data)):
                    yield from self._messages_in(inner)
            else:
                yield from self._messages_in(record)

    def _intact_records(self, file: BoundedFile) -> Iterator[Any]:
        """Yield records up to the first damaged or truncated one; of a truncated chunk, yield the part in the file."""
        reader = self._library.StreamReader(file, skip_magic=True, emit_chunks=True, record_size_limit=None)
        records = iter(reader.records)
        while True:
            start = file.tell()
            try:
                record = next(records, None)
            except self._library_file.library("mcap.exceptions").EndOfFile:
                yield from self._rest_of_chunk(file, start)
                return
            except Exception:  # the library raises many types for a damaged record
                self._damaged += 1
                return
            if record is None or file.cut:
                return
            yield record

    def _rest_of_chunk(self, file: BoundedFile, start: int) -> Iterator[Any]:
        file.seek(start)
        if file.cut and file.read(_HEAD_BYTES)[:1] == _CHUNK:
            with suppress(Exception):  # the library raises many types if nothing is left
                yield self._records.Chunk.read(self._library_file.library("mcap.data_stream").ReadDataStream(file))

    def _chunk(self, chunk: Any) -> bytes | None:
        """Unpack a chunk; return None if it is damaged."""
        try:
            cut = self._file.cut
            data = unpacked(self._library_file, chunk.compression, chunk.data, chunk.uncompressed_size, cut)
        except ValueError:
            self._damaged += 1
            return None
        if not cut and chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            self._damaged += 1
            return None
        return data

    def _messages_in(self, record: Any) -> Iterator[Message]:
        """Process a record that is not a chunk; if it is a message, yield it."""
        if isinstance(record, self._records.Schema):
            self._schemas[record.id] = record
        elif isinstance(record, self._records.Channel):
            self._channels[record.id] = record.topic, self._schema(record)
        elif isinstance(record, self._records.Message):
            if record.channel_id not in self._channels or record.log_time >= 1 << 63:
                self._damaged += 1
                return
            topic, schema = self._channels[record.channel_id]
            yield Message(topic, schema, record.log_time, record.data)

    def _schema(self, channel: Any) -> Schema:
        schema = self._schemas.get(channel.schema_id)
        if schema is None:
            return Schema("", channel.message_encoding)
        definition = schema.data.decode("utf-8", "replace") if channel.message_encoding != "json" else ""
        return Schema(schema.name, channel.message_encoding, definition, IDL if schema.encoding == IDL else MSG)
