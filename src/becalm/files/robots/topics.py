"""Messages of many topics, as robots log them: each topic becomes a group of columns."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Integers
from becalm.errors import InputError
from becalm.files.columns import NO_UNIT, Column
from becalm.files.groups import TIME, Group
from becalm.files.library_reader import Foreign
from becalm.files.robots import json_messages, ros_messages
from becalm.files.robots.series import Series
from becalm.files.source import ToldTime
from becalm.files.stamps import Ordered, in_order, instant, seconds_of
from becalm.files.text.csv_header import unique_names

JSON = "json"
ROS = ("ros1", "cdr")

_LATE_NS = 1_000_000_000  # a stamp that is further behind is no late message but another clock
_BURST = 0.1  # of the mean step: a median below it is of messages that were written at once
_SECOND = 1_000_000_000
_MOST_NAMED = 8


class Message(NamedTuple):
    """One message, as it is in the file.

    Attributes
    ----------
    topic : str
        "/imu/data".
    schema : ros_messages.Schema
        Its type; its encoding may also be JSON, or one that is not read.
    log_ns : int
        When it was written, in nanoseconds.
    data : bytes
        What is encoded.
    """

    topic: str
    schema: ros_messages.Schema
    log_ns: int
    data: bytes


class _Topic:
    """What came of one topic."""

    def __init__(self, decode: ros_messages.RosDecoder | json_messages.JsonDecoder) -> None:
        self.decode = decode
        self.series = Series()
        self.log: array[int] = array("q")
        self.stamps: array[int] = array("q")
        self.undecoded = 0

    def add(self, message: Message) -> None:
        """Take a message; one that cannot be decoded is counted."""
        try:
            stamp, numbers = self.decode(message.data)
            told = list(numbers)
            self.log.append(message.log_ns)
        except Exception:  # a library's, of a damaged message: of any kind
            self.undecoded += 1
            return
        if stamp is not None:
            self.stamps.append(stamp if abs(stamp) < 1 << 63 else 0)
        self.series.add(told)


class Topics:
    """The topics of a file while its messages go by.

    Parameters
    ----------
    foreign : Foreign
        The file.
    """

    def __init__(self, foreign: Foreign) -> None:
        self._foreign = foreign
        self._topics: dict[tuple[str, ros_messages.Schema], _Topic | None] = {}
        self._left_out: dict[str, list[str]] = {}

    def add(self, message: Message) -> None:
        """Take the next message."""
        key = message.topic, message.schema
        if key not in self._topics:
            self._topics[key] = self._begun(message)
        if (topic := self._topics[key]) is not None:
            topic.add(message)

    def _begun(self, message: Message) -> _Topic | None:
        why = f"their encoding ({message.schema.encoding or 'none'}) is not read"
        if message.schema.encoding == JSON:
            return _Topic(json_messages.JsonDecoder())
        if message.schema.encoding in ROS:
            try:
                decoder = ros_messages.RosDecoder(self._foreign, message.schema)
            except InputError:
                raise
            except Exception:  # a library's, of a damaged definition: of any kind
                why = "the file does not define their types rightly"
            else:
                if decoder.signals:
                    return _Topic(decoder)
                why = "they hold pictures, point clouds, texts or lists of messages"
        self._left_out.setdefault(why, []).append(f"{message.topic} ({message.schema.type or 'no type'})")
        return None

    def groups(self, notes: tuple[str, ...]) -> list[Group]:
        """Return a group for each topic that holds numbers.

        Parameters
        ----------
        notes : tuple of str
            What must be said of the whole file.

        Raises
        ------
        InputError
            If there is none.
        """
        notes += tuple(f"Left out, for {why}: {few(names)}." for why, names in self._left_out.items())
        found = [
            _group(name, topic, notes)
            for (name, _), topic in self._topics.items()
            if topic is not None and topic.series.count
        ]
        if not found:
            undecoded = any(topic is not None for topic in self._topics.values())
            why = " ".join(notes) or ("No message could be decoded." if undecoded else "It holds no messages.")
            raise InputError(f"{self._foreign.path} holds no messages with numbers in them. {why}")
        return found


def _group(name: str, topic: _Topic, notes: tuple[str, ...]) -> Group:
    ordered = _time(_stamps(topic.log), _stamps(topic.stamps))
    start = instant(ordered.stamps)
    columns = {TIME: Column.of(seconds_of(ordered.stamps, _SECOND), "s")}
    values = topic.series.columns()
    titles = unique_names((TIME, *values))
    for title, (field, column) in zip(titles[1:], values.items(), strict=True):
        unit = next((unit for begin, unit in topic.decode.units.items() if field.startswith(begin)), NO_UNIT)
        columns[title] = Column.of(column if ordered.order is None else column[ordered.order], unit)
    told = (*notes, *ordered.notes, *_what_is_missing(topic))
    return Group(name, columns, topic.series.count, ToldTime(TIME, start=start), told)


def _what_is_missing(topic: _Topic) -> Iterator[str]:
    if topic.undecoded:
        yield f"Messages that could not be decoded were left out: {topic.undecoded:,}."
    if topic.decode.left_out:
        yield f"Texts, nested and long lists were left out: {few(sorted(topic.decode.left_out))}."
    if topic.series.full:
        yield "There are more names of numbers than columns that can be; some were left out."


def few(names: list[str]) -> str:
    """Name the first of many, and say how many more there are."""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return ", ".join(names[:_MOST_NAMED]) + more


def _stamps(held: array[int]) -> Integers:
    return np.array(held, np.int64)


def _time(log: Integers, stamps: Integers) -> Ordered:
    """Choose the time of measuring where messages tell it and it runs, else that of writing."""
    logged = in_order(log)
    if len(stamps) != len(log):
        return _by_log(logged, "for its messages have no stamp of their own")
    if logged.order is not None:
        stamps = stamps[logged.order]
    if why := _why_no_time(stamps):
        return _by_log(logged, f"for header.stamp {why}")
    told = in_order(stamps)
    order = told.order if logged.order is None or told.order is None else logged.order[told.order]
    notes = ("The time is header.stamp.", *(told.notes or logged.notes))
    return Ordered(told.stamps, logged.order if told.order is None else order, notes)


def _why_no_time(stamps: Integers) -> str:
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
        notes.append("They were logged in bursts, so that this is not when they were measured.")
    return logged._replace(notes=tuple(notes))


def gathered(foreign: Foreign, messages: Iterator[Message], notes: Callable[[], tuple[str, ...]]) -> list[Group]:
    """Take all messages; `notes` tells, once they went by, what must be said of the whole file.

    Raises
    ------
    InputError
        If none of them holds numbers.
    """
    topics = Topics(foreign)
    for message in messages:
        topics.add(message)
    return topics.groups(notes())
