"""The SQLite files of ROS 2 bags, read row by row, also where they are cut off."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from urllib.parse import quote

from becalm.errors import InputError
from becalm.files.foreign import Foreign
from becalm.files.ros_messages import IDL, MSG, Schema
from becalm.files.topics import Message

_TABLES = ("messages", "topics")


class Log:
    """One SQLite file, which is closed at the end of a `with`.

    Parameters
    ----------
    foreign : Foreign
        What is read, for messages.
    path : Path
        The file.

    Raises
    ------
    InputError
        If it is a database, but no bag.
    """

    def __init__(self, foreign: Foreign, path: Path) -> None:
        self._foreign = foreign
        self._opened = sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1", uri=True)
        self._cut = self._undefined = False
        self._damaged = 0
        try:
            self._opened.execute("PRAGMA writable_schema = ON")  # then a file that is cut off may be read up to its end
            self._opened.execute("PRAGMA trusted_schema = OFF")
            found = self._column("SELECT name FROM sqlite_master WHERE type = 'table'")
            if not set(_TABLES) <= set(found):
                raise InputError(
                    f"{path} is an SQLite database, but no ROS 2 bag: it has no tables named {' and '.join(_TABLES)}."
                    " Export what you need as CSV."
                )
            self._topics = dict(self._read_topics("message_definitions" in found))
        except BaseException:
            self._opened.close()
            raise

    def __enter__(self) -> Log:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, cause: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it."""
        self._opened.close()

    def _column(self, query: str) -> list[object]:
        return [row[0] for row in self._opened.execute(query)]

    def _read_topics(self, defined: bool) -> Iterator[tuple[int, tuple[str, Schema]]]:
        definitions: dict[str, tuple[str, str]] = {}
        if defined:
            query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            definitions = {kind: (text, IDL if how == IDL else MSG) for kind, how, text in self._opened.execute(query)}
        for number, topic, kind, how in self._opened.execute("SELECT id, name, type, serialization_format FROM topics"):
            self._undefined = self._undefined or not definitions.get(kind, ("", ""))[0]
            yield number, (str(topic), Schema(str(kind), str(how), *definitions.get(kind, ("", MSG))))

    def notes(self) -> tuple[str, ...]:
        """Return what must be said of the file, once its messages went by."""
        notes = []
        if self._cut:
            notes.append("The file is damaged or ends too early; the messages before that were read.")
        if self._damaged:
            notes.append(f"Damaged messages were left out: {self._damaged:,}.")
        if self._undefined:
            notes.append("The bag does not define its types; the standard ones of ROS 2 were taken.")
        return tuple(notes)

    def messages(self) -> Iterator[Message]:
        """Give the messages in the order of the file."""
        rows = self._opened.execute("SELECT topic_id, timestamp, data FROM messages")
        while True:
            try:
                row = rows.fetchone()
            except sqlite3.Error:
                self._cut = True
                return
            if row is None:
                return
            number, log_ns, data = row
            if number not in self._topics or not isinstance(log_ns, int) or not isinstance(data, bytes):
                self._damaged += 1
                continue
            topic, schema = self._topics[number]
            yield Message(topic, schema, log_ns, data)
