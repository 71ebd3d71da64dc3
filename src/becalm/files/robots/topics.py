"""Collect the messages of a robot's log by topic; each topic becomes a table."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Integers
from becalm.errors import InputError
from becalm.files.column_statistics import NO_UNIT, Column
from becalm.files.groups import TIME, Group
from becalm.files.library_reader import LibraryFile
from becalm.files.robots import json_messages, ros_messages
from becalm.files.robots.series import Series
from becalm.files.source import FormatTime
from becalm.files.text.csv_header import unique_names
from becalm.files.timing.integer_stamps import Ordered, in_order, instant, seconds_of

JSON = "json"
ROS = ("ros1", "cdr")
"""The encodings of messages that becalm reads."""

_LATE_NS = 1_000_000_000  # a stamp further behind than this comes from another clock, not from a late message
_BURST = 0.1  # messages came in bursts if the median step is below this fraction of the mean step
_SECOND = 1_000_000_000  # in nanoseconds
_MOST_NAMED = 8  # names in a note


class Message(NamedTuple):
    """One message, still encoded.

    Attributes
    ----------
    topic : str
        Name of its topic, such as "/imu/data".
    schema : ros_messages.Schema
        Its type. The encoding may also be JSON, or an encoding that becalm cannot read.
    log_ns : int
        Time when it was logged, in nanoseconds since 1970.
    data : bytes
        The encoded message.
    """

    topic: str
    schema: ros_messages.Schema
    log_ns: int
    data: bytes


class _Topic:
    """The numbers and stamps of one topic."""

    def __init__(self, decode: ros_messages.RosDecoder | json_messages.JsonDecoder) -> None:
        self.decode = decode
        self.series = Series()
        self.log: array[int] = array("q")
        self.stamps: array[int] = array("q")
        self.undecoded = 0

    def add(self, message: Message) -> None:
        """Add a message, or count it if it cannot be decoded."""
        try:
            stamp, numbers = self.decode(message.data)
            values = list(numbers)
            self.log.append(message.log_ns)
        except Exception:  # the libraries raise many types for a damaged message
            self.undecoded += 1
            return
        if stamp is not None:
            self.stamps.append(stamp if abs(stamp) < 1 << 63 else 0)
        self.series.add(values)


class Topics:
    """A collector of a file's messages by topic.

    Parameters
    ----------
    library_file : LibraryFile
        The file.
    """

    def __init__(self, library_file: LibraryFile) -> None:
        self._library_file = library_file
        self._topics: dict[tuple[str, ros_messages.Schema], _Topic | None] = {}
        self._left_out: dict[str, list[str]] = {}

    def add(self, message: Message) -> None:
        """Add the next message."""
        key = message.topic, message.schema
        if key not in self._topics:
            self._topics[key] = self._new_topic(message)
        if (topic := self._topics[key]) is not None:
            topic.add(message)

    def _new_topic(self, message: Message) -> _Topic | None:
        why = f"their encoding ({message.schema.encoding or 'none'}) is not read"
        if message.schema.encoding == JSON:
            return _Topic(json_messages.JsonDecoder())
        if message.schema.encoding in ROS:
            try:
                decoder = ros_messages.RosDecoder(self._library_file, message.schema)
            except InputError:
                raise
            except Exception:  # the library raises many types for a damaged definition
                why = "the file does not define their types correctly"
            else:
                if decoder.has_signals:
                    return _Topic(decoder)
                why = "they hold images, point clouds, texts or lists of messages"
        self._left_out.setdefault(why, []).append(f"{message.topic} ({message.schema.type or 'no type'})")
        return None

    def groups(self, notes: tuple[str, ...]) -> list[Group]:
        """Return a group for each topic that holds numbers.

        Parameters
        ----------
        notes : tuple of str
            Notes on the whole file.

        Raises
        ------
        InputError
            If there is no such topic.
        """
        notes += tuple(f"Left out, because {why}: {shorten_list(names)}." for why, names in self._left_out.items())
        groups = [
            _group(name, topic, notes)
            for (name, _), topic in self._topics.items()
            if topic is not None and topic.series.count
        ]
        if not groups:
            undecoded = any(topic is not None for topic in self._topics.values())
            why = " ".join(notes) or ("No message could be decoded." if undecoded else "It holds no messages.")
            raise InputError(f"{self._library_file.path} holds no messages with numbers in them. {why}")
        return groups


def _group(name: str, topic: _Topic, notes: tuple[str, ...]) -> Group:
    ordered = _time(_stamps(topic.log), _stamps(topic.stamps))
    start = instant(ordered.stamps)
    columns = {TIME: Column.of(seconds_of(ordered.stamps, _SECOND), "s")}
    values = topic.series.columns()
    titles = unique_names((TIME, *values))
    for title, (field, column) in zip(titles[1:], values.items(), strict=True):
        unit = next((unit for begin, unit in topic.decode.units.items() if field.startswith(begin)), NO_UNIT)
        columns[title] = Column.of(column if ordered.order is None else column[ordered.order], unit)
    all_notes = (*notes, *ordered.notes, *_omissions(topic))
    return Group(name, columns, topic.series.count, FormatTime(TIME, start=start), all_notes)


def _omissions(topic: _Topic) -> Iterator[str]:
    if topic.undecoded:
        yield f"Messages that could not be decoded were left out: {topic.undecoded:,}."
    if topic.decode.left_out:
        yield f"Texts, nested and long lists were left out: {shorten_list(sorted(topic.decode.left_out))}."
    if topic.series.full:
        yield "The messages have more names of numbers than a table can have columns; some were left out."


def shorten_list(names: list[str]) -> str:
    """Return the first of some names, and how many more there are."""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more


def _stamps(held: array[int]) -> Integers:
    return np.array(held, np.int64)


def _time(log: Integers, stamps: Integers) -> Ordered:
    """Return the times of measurement if all messages have a valid one; otherwise the times of logging."""
    logged = in_order(log)
    if len(stamps) != len(log):
        return _by_log(logged, "because its messages have no stamp of their own")
    if logged.order is not None:
        stamps = stamps[logged.order]
    if why := _why_no_time(stamps):
        return _by_log(logged, f"because header.stamp {why}")
    measured = in_order(stamps)
    order = measured.order if logged.order is None or measured.order is None else logged.order[measured.order]
    notes = ("The time is header.stamp.", *(measured.notes or logged.notes))
    return Ordered(measured.stamps, logged.order if measured.order is None else order, notes)


def _why_no_time(stamps: Integers) -> str:
    """Return why stamps are not valid as times of measurement; "" if they are."""
    if (stamps <= 0).any():
        return "is not set"
    behind = np.maximum.accumulate(stamps) - stamps
    if behind.max(initial=0) > _LATE_NS:
        return f"goes back by {behind.max() / _SECOND:g} s"
    repeats = int(np.count_nonzero(np.diff(np.sort(stamps)) == 0))
    return f"repeats ({repeats:,} of {len(stamps):,} messages)" if repeats else ""


def _by_log(logged: Ordered, why: str) -> Ordered:
    notes = [f"The time is when messages were logged, {why}.", *logged.notes]
    steps = np.diff(logged.stamps)
    repeats = int(np.count_nonzero(steps == 0))
    if repeats:
        notes.append(f"Messages that were logged at the same instant as the one before: {repeats:,}.")
    if len(steps) > 2 and np.median(steps) < _BURST * steps.mean():
        notes.append("They were logged in bursts, so this is not the time when they were measured.")
    return logged._replace(notes=tuple(notes))


def collect_groups(
    library_file: LibraryFile, messages: Iterator[Message], notes: Callable[[], tuple[str, ...]]
) -> list[Group]:
    """Collect all messages; `notes`, called after the last one, returns the notes on the whole file.

    Raises
    ------
    InputError
        If no message holds numbers.
    """
    topics = Topics(library_file)
    for message in messages:
        topics.add(message)
    return topics.groups(notes())
