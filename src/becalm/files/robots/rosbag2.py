"""Read the SQLite files of ROS 2 bags row by row, also truncated ones."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any
from urllib.parse import quote

from becalm.errors import InputError
from becalm.files.library_reader import LibraryFile
from becalm.files.robots.ros_messages import IDL, MSG, Schema
from becalm.files.robots.topics import Message

_TABLES = ("messages", "topics")
_SPARE = 1 << 20  # bytes that a value may have beyond the size of the file


class RosBag2:
    """An SQLite file of a bag, closed at the end of a `with`.

    Parameters
    ----------
    library_file : LibraryFile
        The file or folder that the user named, for messages.
    path : Path
        The file.

    Raises
    ------
    InputError
        If it is a database, but not a bag.
    """

    def __init__(self, library_file: LibraryFile, path: Path) -> None:
        self._library_file = library_file
        self._held = ExitStack()
        self._undefined = False
        readable = _whole_pages(path, self._held)
        self._cut = readable != path
        self._opened = sqlite3.connect(f"file:{quote(str(readable.absolute()))}?mode=ro&immutable=1", uri=True)
        self._held.callback(self._opened.close)
        self._damaged = 0
        try:
            self._opened.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, path.stat().st_size + _SPARE)  # no message is longer
            self._opened.execute("PRAGMA writable_schema = ON")  # so that SQLite reads a truncated file up to its end
            self._opened.execute("PRAGMA trusted_schema = OFF")
            names = self._column("SELECT name FROM sqlite_master WHERE type = 'table'")
            if not set(_TABLES) <= set(names):
                raise InputError(
                    f"{path} is an SQLite database, but not a ROS 2 bag: it lacks the tables {' and '.join(_TABLES)}."
                    " Export what you need as CSV."
                )
            self._topics = dict(self._read_topics("message_definitions" in names))
        except BaseException:
            self._held.close()
            raise

    def __enter__(self) -> RosBag2:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, cause: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self._held.close()

    def _column(self, query: str) -> list[object]:
        return [row[0] for row in self._opened.execute(query)]

    def _rows(self, query: str) -> Iterator[Any]:
        """Yield rows up to the first damage."""
        try:
            yield from self._opened.execute(query)
        except sqlite3.Error:
            self._cut = True

    def _read_topics(self, defined: bool) -> Iterator[tuple[int, tuple[str, Schema]]]:
        definitions: dict[str, tuple[str, str]] = {}
        if defined:
            query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            definitions = {kind: (text, IDL if how == IDL else MSG) for kind, how, text in self._opened.execute(query)}
        for number, topic, kind, how in self._opened.execute("SELECT id, name, type, serialization_format FROM topics"):
            self._undefined = self._undefined or not definitions.get(kind, ("", ""))[0]
            yield number, (str(topic), Schema(str(kind), str(how), *definitions.get(kind, ("", MSG))))

    def notes(self) -> tuple[str, ...]:
        """Return notes on the file; call this after the last message."""
        notes = []
        if self._cut:
            notes.append("The file is damaged or ends too early; the messages before that were read.")
        if self._damaged:
            notes.append(f"Damaged messages were left out: {self._damaged:,}.")
        if self._undefined:
            notes.append("The bag does not define its types; the standard types of ROS 2 were used.")
        return tuple(notes)

    def messages(self) -> Iterator[Message]:
        """Yield the messages in the order of the file."""
        for number, log_ns, data in self._rows("SELECT topic_id, timestamp, data FROM messages"):
            if number not in self._topics or not isinstance(log_ns, int) or not isinstance(data, bytes):
                self._damaged += 1
                continue
            topic, schema = self._topics[number]
            yield Message(topic, schema, log_ns, data)


def _whole_pages(path: Path, held: ExitStack) -> Path:
    """Return a file, or a temporary copy without a truncated last page, which SQLite would fill with zeros."""
    with path.open("rb") as file:
        page = int.from_bytes(file.read(18)[16:], "big")
        page, size = 1 << 16 if page == 1 else page, path.stat().st_size
        if not page or size % page == 0:
            return path
        copy = (
            Path(held.enter_context(tempfile.TemporaryDirectory(prefix="becalm.", ignore_cleanup_errors=True)))
            / path.name
        )
        file.seek(0)
        with copy.open("wb") as whole:
            shutil.copyfileobj(file, whole)
            whole.truncate(size - size % page)
    return copy
