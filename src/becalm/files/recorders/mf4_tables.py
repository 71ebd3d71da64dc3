"""Write one table as a channel group of an MF4 file: its master, its channels, and their rows chunk by chunk."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from becalm.core.arrays import Floats
from becalm.errors import OutputError
from becalm.files.column_arrays import is_text, numbers_of, texts_of, unit_of_field
from becalm.files.groups import TIME
from becalm.files.recorders.mf4_columns import NO_START
from becalm.files.timing.time_column import is_time_name
from becalm.files.timing.times import EPOCHS, PER_SECOND, SECONDS
from becalm.files.units.unit_spelling import time_unit

_MOST_WORDS = 1 << 16  # distinct words of a channel; their codes have 16 bits
_TIME, _INDEX = ("time", 1), ("index", 4)  # names of masters, and their synchronisation types

Samples = tuple[NDArray[Any], NDArray[np.bool_] | None]  # values, and a mask of invalid ones


class MdfTable:
    """A writer of one table as a channel group.

    Parameters
    ----------
    library : module
        asammdf.
    group : str
        The name of the table's group.
    start : str
        Its first instant as ISO 8601 text, or "" if unknown.
    """

    def __init__(self, library: ModuleType, group: str, start: str) -> None:
        self._library, self._group, self.start = library, group, start
        self._number: int | None = None
        self._rows = 0
        self._first_s = 0.0
        self._words: dict[str, dict[str, int]] = {}
        self.after_ns: int | None = 0
        """Time from the start of the file to time 0 of the table, in ns; None if unknown."""

    @property
    def zero_ns(self) -> int | None:
        """Return the instant of time 0 of the table, in ns since 1970; None if unknown."""
        start = instant_ns(self.start)
        return None if start is None else start - round(self._first_s * 1e9)

    def write(self, log: Any, table: pa.Table) -> None:
        """Append rows; the first ones define the channels."""
        if not table.num_rows:
            return
        times, kind, master = self._master(table)
        fields = [field for field in table.schema if field.name != master] or list(table.schema)
        samples = [self._samples(field, table.column(field.name)) for field in fields]
        if self._number is None:
            self._first_s = float(times[0]) if len(times) and np.isfinite(times[0]) else 0.0
            self._number = self._append(log, fields, samples, times, kind)
        else:
            log.extend(self._number, [(times, None), *samples])
        self._rows += table.num_rows

    def close(self, log: Any) -> None:
        """Set the conversions and the time offset, which are known only after the last row."""
        if self._number is None:
            return
        channels = log.groups[self._number].channels
        for channel in channels[1:]:
            if channel.name in self._words:
                channel.conversion = self._conversion(self._words[channel.name])
        if self.after_ns is None:
            log.groups[self._number].channel_group.comment = NO_START
        elif self.after_ns:
            channels[0].conversion = self._from_values({"a": 1.0, "b": self.after_ns / 1e9})

    def _append(self, log: Any, fields: list[pa.Field], samples: list[Samples], times: Floats, kind: Any) -> int:
        signals = [
            self._library.Signal(
                values,
                times,
                unit=unit_of_field(field),
                name=field.name,
                encoding="utf-8" if values.dtype.kind == "S" else None,
                invalidation_bits=invalid,
                master_metadata=kind,
                bit_count=1 if pa.types.is_boolean(field.type) else None,
            )
            for field, (values, invalid) in zip(fields, samples, strict=True)
        ]
        return int(log.append(signals, acq_name=self._group, comment="", common_timebase=True))

    def _master(self, table: pa.Table) -> tuple[Floats, tuple[str, int], str]:
        """Return the times of rows in s, the kind of master, and the column that is only the master.

        A time in seconds that comes first, from `with_time`, precedes other columns; rows without times are counted.
        """
        named = [name for name in table.column_names if is_time_name(name)]
        first = table.column_names[0]
        for name in [first] if first.rstrip("_") == TIME else [TIME] if TIME in named else named:
            column = table.column(name)
            if pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
                unit = time_unit(name, unit_of_field(table.schema.field(name)))
                values = numbers_of(column)[0].astype(np.float64)
                unit = unit or next((one for one, low, high in EPOCHS if len(values) and low <= values[0] <= high), "")
                seconds = values * SECONDS[unit] if unit in SECONDS else values / PER_SECOND.get(unit, 1.0)
                return seconds, _TIME, name if name in (TIME, first) and name.rstrip("_") == TIME else ""
        return np.arange(self._rows, self._rows + table.num_rows, dtype=np.float64), _INDEX, ""

    def _samples(self, field: pa.Field, column: pa.ChunkedArray) -> Samples:
        """Return values, and a mask of invalid ones if there may be any; floats use NaN instead."""
        if pa.types.is_dictionary(field.type):
            listed = [str(word) for chunk in column.chunks for word in chunk.dictionary.drop_null().to_pylist()]
            return self._codes(field.name, listed, texts_of(column)), None
        if is_text(field.type):
            return np.array([text.encode() or b"\0" for text in texts_of(column)]), None
        values, missing = numbers_of(column)
        if values.dtype.kind == "f":
            return values, None
        return values.astype(np.uint8) if values.dtype.kind == "b" else values, missing

    def _codes(self, name: str, listed: list[str], texts: NDArray[np.object_]) -> NDArray[np.uint16]:
        """Return the codes of words: their indices in the first list of words, extended by new words."""
        words = self._words.setdefault(name, {})
        for word in listed:
            words.setdefault(word, len(words))
        distinct, places = np.unique(texts.astype(str), return_inverse=True)
        codes = [words.setdefault(str(word), len(words)) for word in distinct]
        if len(words) > _MOST_WORDS:
            raise OutputError(f"{name!r} holds more than {_MOST_WORDS} words; cast that column to pyarrow.string().")
        return np.array(codes, np.uint16)[places]

    def _conversion(self, words: dict[str, int]) -> Any:
        pairs = {f"val_{code}": code for code in words.values()} | {
            f"text_{code}": word for word, code in words.items()
        }
        return self._from_values({**pairs, "default": ""})

    def _from_values(self, values: dict[str, Any]) -> Any:
        return self._library.blocks.conversion_utils.from_dict(values)


def instant_ns(text: str) -> int | None:
    """Return an ISO 8601 instant in ns since 1970, or None if the text is not an instant."""
    try:
        return int(np.datetime64(text.removesuffix("Z"), "ns").astype(np.int64)) if text else None
    except ValueError:
        return None
