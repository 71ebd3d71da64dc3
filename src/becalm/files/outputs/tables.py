"""Make the output tables: the columns of the file, with clean channels in the place of the noisy ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.core.arrays import Codes, Floats
from becalm.core.reading_verdicts import Verdict
from becalm.core.recording import Recording
from becalm.errors import RecordingError
from becalm.files.groups import START, TIME
from becalm.files.inputs.opening import OpenSource
from becalm.files.roles import SIGMA
from becalm.files.source import TIME as TIME_ROLE
from becalm.files.source import SourceFile
from becalm.files.timing.time_column import is_time_name

VERDICT = "_verdict"
"""The ending of the name of a column of verdicts."""

_TIME = "time_s"  # the time column of `recording_table`
_VERDICT_TYPE = pa.dictionary(pa.int8(), pa.string())  # the type of a column of verdicts: words


class CleanChannel(NamedTuple):
    """Some rows of a clean channel.

    Attributes
    ----------
    signal, sigma : (n,) float arrays
        The clean signal and its standard uncertainty, in `unit`.
    unit : str
        The unit of the channel, "" if unknown.
    parts : mapping of str to (n,) float array
        Named parts of the signal, in `unit`.
    verdicts : (n,) array of codes, optional
        The verdict on each measurement, if it is to be written.
    """

    signal: Floats
    sigma: Floats
    unit: str = ""
    parts: Mapping[str, Floats] = MappingProxyType({})
    verdicts: Codes | None = None

    def columns(self, name: str) -> list[tuple[str, Floats]]:
        """Return the names and values of the output columns of a channel `name`, except its verdicts."""
        parts = [(f"{name}_{part}", values) for part, values in self.parts.items()]
        return [(name, self.signal), (name + SIGMA, self.sigma), *parts]


def output_table(source: SourceFile, signal: Recording, sigma: Recording) -> pa.Table:
    """Put clean channels and their uncertainties in the place of the noisy ones.

    Parameters
    ----------
    source : SourceFile
        The file that was cleaned.
    signal, sigma : Recording
        The clean channels and their standard uncertainties; same names, as many rows as the file.

    Returns
    -------
    pyarrow.Table
        The columns of the file in their order, each NAME of `signal` followed by NAME_sigma.

    Raises
    ------
    RecordingError
        If names or numbers of rows do not agree.
    """
    _refuse_unknown_channels(source, signal, sigma)
    clean = {
        name: CleanChannel(signal.channel(name), sigma.channel(name), unit)
        for name, unit in zip(signal.names, signal.units, strict=True)
    }
    return output_block(source.table, clean)


def output_block(table: pa.Table, clean: Mapping[str, CleanChannel]) -> pa.Table:
    """Put clean channels in the place of the noisy ones, in a whole table or in some of its rows.

    Parameters
    ----------
    table : pyarrow.Table
        Columns in the order of the file.
    clean : mapping of str to CleanChannel
        Clean channels by the names of the columns that they replace; contiguous arrays are not copied.

    Returns
    -------
    pyarrow.Table
        The columns in their order, each NAME of `clean` followed by NAME_sigma, NAME_PART for each of its parts, and
        NAME_verdict if it has verdicts; an older NAME_sigma is left out.
    """
    fields, columns = [], []
    replaced = {name + SIGMA for name in clean}
    for field, column in zip(table.schema, table.columns, strict=True):
        if field.name in clean:
            own = clean[field.name]
            for name, values in own.columns(field.name):
                fields.append(_field(name, own.unit, field.metadata if name == field.name else None))
                columns.append(pa.array(values))
            if own.verdicts is not None:
                fields.append(pa.field(field.name + VERDICT, _VERDICT_TYPE))
                columns.append(verdict_words(own.verdicts))
        elif field.name not in replaced:
            fields.append(field)
            columns.append(column)
    return pa.table(columns, schema=pa.schema(fields, metadata=table.schema.metadata))


def verdict_words(verdicts: Codes) -> pa.DictionaryArray:
    """Return verdicts (n,) as words: "used", "missing", "spike" and so on."""
    words = pa.array([verdict.name.lower() for verdict in Verdict], pa.string())
    return pa.DictionaryArray.from_arrays(pa.array(verdicts, pa.int8()), words)


def recording_table(recording: Recording, sigma: Recording | None = None) -> pa.Table:
    """Make a table of a recording: `time_s`, then each channel, followed by NAME_sigma if `sigma` is given.

    Raises
    ------
    RecordingError
        If the names or numbers of rows do not agree, or a channel is called `time_s`.
    """
    if not isinstance(recording, Recording):
        raise RecordingError(f"A Recording is needed; {type(recording).__name__} came: write(path, recording).")
    if _TIME in recording.names:
        raise RecordingError(f"A channel is called {_TIME!r}, which is the time column's name; rename the channel.")
    if sigma is not None and (sigma.names != recording.names or len(sigma) != len(recording)):
        raise RecordingError(
            f"sigma has {len(sigma)} rows of {sigma.names}; {recording!r} needs its own names and rows."
        )
    fields, columns = [_field(_TIME, "s")], [pa.array(recording.times_s)]
    for name, unit in zip(recording.names, recording.units, strict=True):
        fields.append(_field(name, unit))
        columns.append(pa.array(recording.channel(name)))
        if sigma is not None:
            fields.append(_field(name + SIGMA, unit))
            columns.append(pa.array(sigma.channel(name)))
    return pa.table(columns, schema=pa.schema(fields))


def _field(name: str, unit: str, metadata: Mapping[bytes, bytes] | None = None) -> pa.Field:
    own = {**(metadata or {}), **({b"unit": unit.encode()} if unit else {})}
    return pa.field(name, pa.float64(), metadata=own or None)


def _refuse_unknown_channels(source: SourceFile, signal: Recording, sigma: Recording) -> None:
    rows = source.table.num_rows
    if len(signal) != rows or len(sigma) != rows:
        raise RecordingError(f"{len(signal)} clean rows and {len(sigma)} uncertainties came for a file of {rows} rows.")
    if signal.names != sigma.names:
        raise RecordingError(f"Clean channels are {signal.names}, uncertainties {sigma.names}; they must be the same.")
    strangers = [name for name in signal.names if name not in source.table.column_names]
    if strangers:
        raise RecordingError(f"The file has no column {strangers[0]!r}; it has {', '.join(source.table.column_names)}.")


# Add a column of time in seconds to the rows of a file that has no numeric time column.


def with_time(
    source: OpenSource, write: Callable[[pa.Table], None], always: bool = False
) -> Callable[[pa.Table], None]:
    """Return a writer that puts a column of time in seconds first, unless the file has a numeric time column.

    Other programs read dates and times of day as text, and a rate from the command line is not in any column.

    Parameters
    ----------
    source : OpenSource
        The file. Its rows must be written in order.
    write : callable
        Writes the next rows, a pyarrow table.
    always : bool
        Whether to put the time first even if the file has a numeric time column, unless that is `time_s` and the
        source's own: a format with a time of its own, as MF4, would take another column for seconds.

    Returns
    -------
    callable
        `write` itself if the file has a numeric time column; else a function that adds the time and calls `write`.
    """
    own = any(column.name == TIME and column.role == TIME_ROLE for column in source.columns)
    if own or (not always and any(_is_numeric_time(field) for field in source.schema)):
        return write
    names = source.schema.names
    field = _FIELD.with_name(next(name for n in range(len(names) + 1) if (name := TIME + "_" * n) not in names))
    row, steps = 0, source.clock.start_s / source.clock.step_s if always else 0.0
    start = {START: source.start} if source.start else {}

    def write_timed(table: pa.Table) -> None:
        nonlocal row, steps
        elapsed = steps + np.cumsum(source.elapsed_steps(row, table.num_rows))
        if len(elapsed):
            row, steps = row + table.num_rows, float(elapsed[-1])
        timed = table.add_column(0, field, pa.array(elapsed * source.clock.step_s))
        write(timed.replace_schema_metadata({**(table.schema.metadata or {}), **start}))

    return write_timed


_FIELD = pa.field(TIME, pa.float64(), metadata={b"unit": b"s"})


def _is_numeric_time(field: pa.Field) -> bool:
    return is_time_name(field.name) and (pa.types.is_integer(field.type) or pa.types.is_floating(field.type))
