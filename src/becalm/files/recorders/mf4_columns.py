"""Read the channels of an MDF file as columns: apply conversions once, and mark invalid samples as missing."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.core.arrays import Floats
from becalm.files.column_statistics import Column
from becalm.files.library_reader import LibraryFile

_LINEAR, _FORMULA, _TABLE_OF_TEXTS, _RANGES_OF_TEXTS = 1, 3, 7, 8  # types of conversions
_MOST_PARTS = 4096  # most columns of one channel
_ELSEWHERE = 1  # type of channel whose rows hold offsets into a block of values, each preceded by its length
_LENGTH_BYTES = 4  # bytes of the length before each value
_ENOUGH = 1000  # rows to inspect to decide whether a channel has names or numbers
_MOSTLY = 0.5  # least share of rows without a number in a channel of names

NO_START = "Its first instant is not known; that of the file is another group's."
"""Comment of a channel group to which the start time of the file does not apply."""

Values = NDArray[Any]
Convert = Callable[[Values], Values]  # converts samples of asammdf to those of a column


class Mf4Channel(NamedTuple):
    """A channel of a file: asammdf's file object, and the indices of the channel's group and of the channel."""

    log: Any
    group: int
    number: int

    @property
    def head(self) -> Any:
        """Return asammdf's description of the channel."""
        return self.log.groups[self.group].channels[self.number]

    @property
    def unit(self) -> str:
        """Return the unit that the file states, or ""."""
        return str(self.log.get_channel_unit(group=self.group, index=self.number) or "")

    def read(self, first: int, last: int, raw: bool = False) -> tuple[Values, Values | None]:
        """Return samples, unconverted if `raw`, and a mask of the invalid ones, None if there is none."""
        values, invalid = self.log.get(
            group=self.group,
            index=self.number,
            samples_only=True,
            raw=raw,
            ignore_invalidation_bits=True,
            record_offset=first,
            record_count=last - first,
        )
        return values, invalid

    def has_wrong_offsets(self) -> bool:
        """Return whether an offset lies outside the channel's values, or is less than that of the row before.

        At such an offset, asammdf would read other bytes as a length. This uses internals of asammdf, because only they
        return the offsets without following them.
        """
        if getattr(self.head, "channel_type", 0) != _ELSEWHERE or not hasattr(self.log.groups[self.group], "sorted"):
            return False
        log, group = self.log._mdf, self.log.groups[self.group]
        links = group.channel_dependencies[self.number]
        where = (self.head, group, self.group, self.number, links)
        places = log._get_scalar(*where, None, None, True, 0, None, False, skip_vlsd=True)[0].astype(np.uint64)
        values = np.frombuffer(log._load_signal_data(group, self.number), np.uint8)
        if not len(places) or len(values) < _LENGTH_BYTES:
            return bool(len(places))
        most = np.uint64(len(values) - _LENGTH_BYTES)
        if (places > most).any() or (np.diff(places.astype(np.int64)) < 0).any():
            return True
        parts = values[places.astype(np.int64)[:, None] + np.arange(_LENGTH_BYTES)]
        return bool((parts.view("<u4")[:, 0] > most - places).any())


class MasterTime:
    """A reader of a group's times since its first row; the times are in its master channel."""

    def __init__(self, channel: Mf4Channel) -> None:
        self._channel = channel
        conversion = channel.head.conversion
        scaled = conversion is not None and _is_linear(conversion)
        self._tick_s, self._offset = (float(conversion.a), float(conversion.b)) if scaled else (1.0, 0.0)
        self._linear = (conversion is None or scaled) and self._raw(0, 1).dtype.kind in "iuf"
        self._first = self._raw(0, 1)[0] if self._linear else self._seconds(0, 1)[0]

    @property
    def first_s(self) -> float:
        """Return the time of the first row in seconds since the start of the file."""
        return float(self._first) * self._tick_s + self._offset if self._linear else float(self._first)

    def read(self, first: int, last: int) -> Floats:
        """Return seconds since the first row; the difference is taken before scaling, so that no digits are lost."""
        if not self._linear:
            return np.asarray(self._seconds(first, last) - self._first, np.float64)
        raw = self._raw(first, last)
        kind = np.float64 if raw.dtype.kind == "f" else np.int64
        return np.asarray((raw.astype(kind) - kind(self._first)) * self._tick_s, np.float64)

    def _raw(self, first: int, last: int) -> Values:
        return self._channel.read(first, last, raw=True)[0]

    def _seconds(self, first: int, last: int) -> Values:
        log, group = self._channel.log, self._channel.group
        return np.asarray(log.get_master(group, record_offset=first, record_count=last - first))


def columns_of(library_file: LibraryFile, channel: Mf4Channel) -> tuple[list[tuple[str, Column]], list[str]]:
    """Return the named columns of a channel, and notes about it."""
    conversion, name, unit = channel.head.conversion, channel.head.name, channel.unit
    if why := _not_converted(library_file, conversion):
        return [], [f"{name!r} was left out: {why}."]
    if channel.has_wrong_offsets():
        return [], [f"{name!r} was left out: its texts are not where its rows say."]
    if getattr(conversion, "conversion_type", 0) in (_TABLE_OF_TEXTS, _RANGES_OF_TEXTS):
        return [(name, _of_texts(channel))], []
    probe, _ = channel.read(0, 1)
    parts = _parts(name, probe)
    if len(parts) > _MOST_PARTS:
        return [], [f"{name!r} was left out: it has {len(parts)} values a row."]
    columns = []
    for title, pick in parts:
        flag = channel.head.bit_count == 1 and conversion is None
        of_type, convert = _type_of(pick(probe).astype(bool) if flag else pick(probe), conversion is not None)
        if of_type is None:
            return [], [f"{name!r} was left out: it holds values of an unknown type."]
        columns.append((title, Column(of_type, _reader(channel, _both(pick, convert)), unit)))
    return columns, []


def _of_texts(channel: Mf4Channel) -> Column:
    """Return a column of texts, or of numbers if fewer than half of the values convert to a text such as "invalid"."""
    conversion = channel.head.conversion
    if np.isnan(_numbers(channel.read(0, _ENOUGH)[0])).mean() < _MOSTLY:
        return Column(pa.float64(), _reader(channel, _numbers), channel.unit)

    def named(counts: Values) -> Values:
        return _texts(conversion.convert(counts, as_object=True))

    return Column(pa.string(), _reader(channel, named, raw=True), channel.unit)


def _not_converted(library_file: LibraryFile, conversion: Any) -> str:
    """Return why a conversion, or one that it refers to, cannot be applied, or "" if it can."""
    if conversion is None:
        return ""
    if getattr(conversion, "conversion_type", 0) == _FORMULA:
        formula = str(conversion.formula)
        numbers = {name: np.ones(1) for name in ("X", "X1", "INF", "NaN")}
        if library_file.library("numexpr").validate(formula.replace("X1", "X"), local_dict=numbers) is not None:
            return f"its formula {formula[:60]!r} is not understood"
    others = getattr(conversion, "referenced_blocks", None) or {}
    return next(
        (why for one in others.values() if _is_conversion(one) and (why := _not_converted(library_file, one))), ""
    )


def _is_conversion(block: Any) -> bool:
    return hasattr(block, "conversion_type")


def _is_linear(conversion: Any) -> bool:
    return getattr(conversion, "conversion_type", 0) == _LINEAR and hasattr(conversion, "a")


def _parts(name: str, values: Values) -> list[tuple[str, Convert]]:
    """Split samples of several numbers; return the name of each part and a function that picks it."""
    if values.dtype.names:
        parts = []
        for field in values.dtype.names:
            inner = _parts(name if field == name else f"{name}.{field}", values[field])
            parts += [(title, _both(itemgetter(field), pick)) for title, pick in inner]
        return parts
    if values.ndim > 1 and values.dtype.kind in "biufc":
        return [(f"{name}_{at}", _element(at)) for at in range(int(np.prod(values.shape[1:])))]
    return [(name, np.asarray)]


def _element(at: int) -> Convert:
    return lambda values: values.reshape(len(values), -1)[:, at]


def _both(one: Convert, other: Convert) -> Convert:
    return lambda values: other(one(values))


def _type_of(values: Values, converted: bool) -> tuple[pa.DataType | None, Convert]:
    """Return the type of a column, None if it is unknown, and the function that converts samples to it."""
    kind = values.dtype.newbyteorder("=")
    if kind.kind in "SUO":
        return pa.string(), _texts
    if kind.kind == "b" or (kind.kind in "iuf" and not converted):
        return pa.from_numpy_dtype(kind), lambda values: values.astype(kind)
    if kind.kind in "iuf":
        return pa.float64(), _numbers
    return None, _numbers


def _texts(values: Values) -> Values:
    return np.array(
        [one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in values.tolist()], object
    )


def _numbers(values: Values) -> Values:
    """Return numbers as float64; NaN if the values are texts."""
    return np.full(len(values), np.nan) if values.dtype.kind in "SUO" else values.astype(np.float64)


def _reader(channel: Mf4Channel, convert: Convert, raw: bool = False) -> Callable[[int, int], Values]:
    def read_rows(first: int, last: int) -> Values:
        values, invalid = channel.read(first, last, raw)
        if len(values) != last - first:
            raise ValueError(f"a channel has {first + len(values)} values where {last} were promised")
        converted = convert(values)
        return converted if invalid is None else np.ma.masked_array(converted, np.asarray(invalid, bool))

    return read_rows
