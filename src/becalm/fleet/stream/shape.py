"""What the columns of a stream's rows are, on the way in and out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from becalm.errors import UsageError
from becalm.files.roles import SIGMA
from becalm.files.tables import VERDICT

Stamps = Literal["timestamp", "timestamp_ntz", "double"]

KIND, READINGS, EVENTS = "kind", "readings", "events"
"""The column that parts what is told from what befell the stream, and its two values."""

BATCH = "sensor string, place bigint, batch binary, stored_s double"
"""Rows on their way to the filters."""

MESSAGE = {"place": "place", "message": "batch", "stored_s": "stored_s"}
"""The columns of messages, and what they are called on their way to the filters."""

ANSWER = "sensor string, told binary, recipe string, event string, event_rows bigint, says string, noticed_ms bigint"
"""What filters answer: rows that are told, or an event."""

_NUMBERS = ("double", "float", "byte", "short", "integer", "long", "tinyint", "smallint", "int", "bigint")
_STAMPS: dict[str, Stamps] = {kind: kind for kind in get_args(Stamps)}
_BESIDE = ("recipe", "event", "event_rows", "says", "noticed", KIND)


@dataclass(frozen=True)
class StreamSchema:
    """The columns of a stream's rows.

    Attributes
    ----------
    key, time : str
        Whose a row is, and its stamp.
    channels : tuple of str
        The readings.
    stamps : {"timestamp", "timestamp_ntz", "double"}
        What stamps are; doubles count seconds.
    in_blocks : bool
        Whether a row has arrays of stamps and readings; what is told then has too.
    """

    key: str
    time: str
    channels: tuple[str, ...]
    stamps: Stamps = "double"
    in_blocks: bool = False

    def __post_init__(self) -> None:
        """Refuse two columns of one name."""
        names = [name for name, _ in self.told]
        twice = [name for number, name in enumerate(names) if name in names[:number]]
        if twice:
            raise UsageError(
                f"Two columns of what is told would be called {twice[0]!r}: each channel NAME has NAME, NAME{SIGMA} "
                f"and NAME{VERDICT}, beside {', '.join((self.key, self.time, *_BESIDE))}; rename one."
            )

    @property
    def told(self) -> list[tuple[str, str]]:
        """The columns of what is told, each with its type."""
        readings = [
            (name + end, self._many(kind))
            for name in self.channels
            for end, kind in (("", "double"), (SIGMA, "double"), (VERDICT, "string"))
        ]
        return [
            (self.key, "string"),
            (KIND, "string"),
            (self.time, self._many(self.stamps)),
            *readings,
            ("recipe", "string"),
            ("event", "string"),
            ("event_rows", "bigint"),
            ("says", "string"),
            ("noticed", "timestamp"),
        ]

    @property
    def told_ddl(self) -> str:
        """The columns of what is told, as Spark reads a schema."""
        return ", ".join(f"{quoted(name)} {kind}" for name, kind in self.told)

    def _many(self, kind: str) -> str:
        return f"array<{kind}>" if self.in_blocks else kind


def quoted(name: str) -> str:
    """Return a column's name as SQL has it."""
    return "`" + name.replace("`", "``") + "`"


def shape_of(columns: Sequence[tuple[str, str]], key: str, time: str, channels: Sequence[str]) -> StreamSchema:
    """Find the shape of rows.

    Parameters
    ----------
    columns : sequence of (str, str)
        Names and types of columns, as Spark calls them.
    key, time : str
        Which tell whose a row is, and when it was.
    channels : sequence of str
        Those of all sensors; rows need not have them all.

    Raises
    ------
    UsageError
        If a column is not there, or of a type that it cannot have.
    """
    kinds = dict(columns)
    there = [name for name in channels if name in kinds]
    missing = [name for name in (key, time) if name not in kinds] or ([] if there else list(channels[:1]))
    if missing:
        raise UsageError(f"The rows have no column {missing[0]!r}; they have {', '.join(map(repr, kinds))}.")
    in_blocks = kinds[time].startswith("array<")
    stamps = _STAMPS.get(_inner(kinds[time]))
    if stamps is None:
        raise UsageError(
            f"The column {time!r} has {kinds[time]}; stamps are timestamps, or seconds as double"
            f"{_advice(time, _inner(kinds[time]))}."
        )
    for name in there:
        if not is_reading(kinds[name], in_blocks=in_blocks):
            what = "arrays of numbers" if in_blocks else "numbers"
            raise UsageError(f"The column {name!r} has {kinds[name]}; readings are {what}.")
    return StreamSchema(key, time, tuple(channels), stamps, in_blocks)


def _inner(kind: str) -> str:
    return kind.removeprefix("array<").removesuffix(">")


def is_reading(kind: str, *, in_blocks: bool) -> bool:
    """Say whether a column of a type, as Spark calls it, may hold readings."""
    return kind.startswith("array<") == in_blocks and (_inner(kind) in _NUMBERS or _inner(kind).startswith("decimal"))


def _advice(time: str, stamps: str) -> str:
    """Say how whole numbers, as files with nanoseconds tell them, become seconds."""
    if stamps not in ("bigint", "long"):
        return ""
    return f"; where it counts nanoseconds make them so: .withColumn({time!r}, col({time!r}) / 1e9)"
