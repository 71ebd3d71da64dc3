"""Read bags of ROS 1 in the order of the file, with or without an index."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from becalm.errors import InputError
from becalm.files.libraries.bounded_file import BoundedFile, bounded_bytes
from becalm.files.libraries.unpacking import unpacked
from becalm.files.library_reader import LibraryFile
from becalm.files.robots.ros_messages import MSG, Schema
from becalm.files.robots.topics import Message

_VERSION = b"#ROSBAG V2.0\n"
_MESSAGE, _HEADER, _CHUNK, _CONNECTION = 2, 3, 5, 7  # opcodes of records


class _CutError(Exception):
    """Raised if the file ends within a record."""


class RosBag1:
    """A bag of ROS 1.

    Parameters
    ----------
    library_file : LibraryFile
        The file or folder that the user named, for messages.
    file : BoundedFile
        The file, at its start.

    Raises
    ------
    InputError
        If it is of another version.
    """

    def __init__(self, library_file: LibraryFile, file: BoundedFile) -> None:
        self._library_file, self._file = library_file, file
        self._library = library_file.library("rosbags.rosbag1.reader")
        self._connections: dict[int, tuple[str, Schema]] = {}
        self._closed, self._cut = False, False
        self._damaged = 0
        first = file.read(len(_VERSION))
        if first != _VERSION:
            version = first[8:].decode("ascii", "replace").strip()
            raise InputError(
                f"{library_file.path} is a ROS bag of version {version}; becalm reads 2.0. Type: rosbag fix"
                f" {library_file.path.name}"
            )

    def notes(self) -> tuple[str, ...]:
        """Return notes on the file; call this after the last message."""
        notes = []
        if self._cut or not self._closed:
            notes.append("The bag was not closed, or was cut off; the messages that are whole were read.")
        if self._damaged:
            notes.append(f"Damaged parts of the bag were left out: {self._damaged:,}.")
        return tuple(notes)

    def messages(self) -> Iterator[Message]:
        """Yield the messages in the order of the file."""
        yield from self._records(self._file)

    def _records(self, file: BoundedFile) -> Iterator[Message]:
        while file.tell() < file.size:
            try:
                header, data, cut = self._record(file)
                is_chunk = header.get_uint8("op") == _CHUNK
                if cut and not is_chunk:
                    return
                messages = [] if is_chunk else list(self._messages_in(header, data))
                inner = self._chunk(header, data, cut) if is_chunk else None
            except _CutError:
                self._cut = True
                return
            except InputError:
                raise
            except Exception:  # the library raises many types for a damaged record
                self._damaged += 1
                return
            yield from messages
            if inner is not None:
                yield from self._records(inner)

    def _record(self, file: BoundedFile) -> tuple[Any, bytes, bool]:
        """Read a record: return its header, its content as far as it is in the file, and whether that is truncated."""
        cut = file.cut
        try:
            header = self._library.Header.read(file)
            size = self._library.read_uint32(file)
            data = file.read(size)
        except self._library.ReaderError:
            if file.cut and not cut:
                raise _CutError from None
            raise
        cut = len(data) < size
        self._cut = self._cut or cut
        return header, data, cut

    def _messages_in(self, header: Any, data: bytes) -> Iterator[Message]:
        """Process a record that is not a chunk; if it is a message, yield it."""
        kind = header.get_uint8("op")
        if kind == _HEADER:
            self._closed = 0 < header.get_uint64("index_pos") <= self._file.size
            if header.get("encryptor"):
                raise InputError(f"{self._library_file.path} is an encrypted ROS bag; decrypt it: rosbag decrypt.")
        elif kind == _CONNECTION:
            about = self._library.Header.read(_prefixed(data))
            schema = Schema(about.get_string("type"), "ros1", about.get_string("message_definition"), MSG)
            topic = self._library.normalize(header.get_string("topic"))
            self._connections[header.get_uint32("conn")] = topic, schema
        elif kind == _MESSAGE:
            if (conn := header.get_uint32("conn")) not in self._connections:
                self._damaged += 1
                return
            topic, schema = self._connections[conn]
            yield Message(topic, schema, header.get_time("time"), data)

    def _chunk(self, header: Any, data: bytes, cut: bool) -> BoundedFile | None:
        """Unpack a chunk; return None if it is damaged."""
        how, size = header.get_string("compression"), header.get_uint32("size")
        try:
            return bounded_bytes(unpacked(self._library_file, how, data, size, cut))
        except ValueError:
            self._damaged += 1
            return None


def _prefixed(data: bytes) -> BoundedFile:
    """Return a file that holds the length of a header and then the header, as the library expects."""
    return bounded_bytes(len(data).to_bytes(4, "little") + data)
