"""Define the columns of a stream's input rows, messages, packed blocks and output rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from becalm.errors import UsageError
from becalm.files.outputs.tables import VERDICT
from becalm.files.roles import SIGMA

Stamps = Literal["timestamp", "timestamp_ntz", "double"]

KIND, READINGS, EVENTS = "kind", "readings", "events"
"""Name of the output column that distinguishes estimates from events, and its two values."""

BATCH = "sensor string, place bigint, batch binary, stored_s double"
"""The Spark schema of the filters' input: packed rows, or messages."""

MESSAGE = {"place": "place", "message": "batch", "stored_s": "stored_s"}
"""Names of the columns of messages, and the corresponding names in `BATCH`."""

ANSWER = (
    "sensor string, estimates binary, recipe string, event string, event_rows bigint, says string, noticed_ms bigint"
)
"""The Spark schema of the filters' output: packed estimates, or an event."""

_NUMBERS = ("double", "float", "byte", "short", "integer", "long", "tinyint", "smallint", "int", "bigint")
_STAMPS: dict[str, Stamps] = {kind: kind for kind in get_args(Stamps)}
_OTHER_COLUMNS = ("recipe", "event", "event_rows", "says", "noticed", KIND)


@dataclass(frozen=True)
class StreamSchema:
    """The columns of a stream's rows.

    Attributes
    ----------
    key, time : str
        The column that names the sensor of a row, and the column of stamps.
    channels : tuple of str
        The columns of readings.
    stamps : {"timestamp", "timestamp_ntz", "double"}
        The type of stamps; doubles are in seconds.
    in_blocks : bool
        Whether each row is a block, with arrays of stamps and readings. If so, the output has arrays too.
    """

    key: str
    time: str
    channels: tuple[str, ...]
    stamps: Stamps = "double"
    in_blocks: bool = False

    def __post_init__(self) -> None:
        """Raise UsageError if two output columns have the same name."""
        names = [name for name, _ in self.output_columns]
        twice = [name for number, name in enumerate(names) if name in names[:number]]
        if twice:
            raise UsageError(
                f"Two columns of the output would be called {twice[0]!r}: each channel NAME has NAME, NAME{SIGMA} "
                f"and NAME{VERDICT}, and there are {', '.join((self.key, self.time, *_OTHER_COLUMNS))}; rename one."
            )

    @property
    def output_columns(self) -> list[tuple[str, str]]:
        """Return the names and Spark types of the output columns."""
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
    def output_ddl(self) -> str:
        """Return the output columns as a Spark schema string."""
        return ", ".join(f"{quoted(name)} {kind}" for name, kind in self.output_columns)

    def _many(self, kind: str) -> str:
        return f"array<{kind}>" if self.in_blocks else kind


def quoted(name: str) -> str:
    """Return a column's name in SQL quotes."""
    return "`" + name.replace("`", "``") + "`"


def shape_of(columns: Sequence[tuple[str, str]], key: str, time: str, channels: Sequence[str]) -> StreamSchema:
    """Check the columns of input rows, and return their description.

    Parameters
    ----------
    columns : sequence of (str, str)
        Names and Spark types of the columns.
    key, time : str
        The column that names the sensor of a row, and the column of stamps.
    channels : sequence of str
        The channels of all sensors; the rows need not have every channel.

    Raises
    ------
    UsageError
        If a column is missing, or has a type that cannot be used.
    """
    kinds = dict(columns)
    present = [name for name in channels if name in kinds]
    missing = [name for name in (key, time) if name not in kinds] or ([] if present else list(channels[:1]))
    if missing:
        raise UsageError(f"The rows have no column {missing[0]!r}; they have {', '.join(map(repr, kinds))}.")
    in_blocks = kinds[time].startswith("array<")
    stamps = _STAMPS.get(_inner(kinds[time]))
    if stamps is None:
        raise UsageError(
            f"The column {time!r} has {kinds[time]}; stamps must be timestamps, or seconds as double"
            f"{_advice(time, _inner(kinds[time]))}."
        )
    for name in present:
        if not is_reading(kinds[name], in_blocks=in_blocks):
            what = "arrays of numbers" if in_blocks else "numbers"
            raise UsageError(f"The column {name!r} has {kinds[name]}; readings are {what}.")
    return StreamSchema(key, time, tuple(channels), stamps, in_blocks)


def _inner(kind: str) -> str:
    return kind.removeprefix("array<").removesuffix(">")


def is_reading(kind: str, *, in_blocks: bool) -> bool:
    """Return whether a column of a Spark type may hold readings."""
    return kind.startswith("array<") == in_blocks and (_inner(kind) in _NUMBERS or _inner(kind).startswith("decimal"))


def _advice(time: str, stamps: str) -> str:
    """Return advice on how to convert whole numbers, such as nanoseconds in files, to seconds."""
    if stamps not in ("bigint", "long"):
        return ""
    return f"; if it counts nanoseconds, convert it: .withColumn({time!r}, col({time!r}) / 1e9)"
