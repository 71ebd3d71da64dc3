"""Columns in what the sensor measured, in the place of the volts it gave."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import pyarrow as pa

from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.files.asked import Asker, ReadOptions
from becalm.files.choosing import holds, listed
from becalm.files.conversion import Conversion, conversion
from becalm.files.roles import unit_of, values_of
from becalm.files.rows import Rows
from becalm.files.source import RawTable
from becalm.files.time_column import named_column
from becalm.files.units import parse_header
from becalm.sensors.record import SensorRecord, applied

SENSORS_OPTION = Asker("--sensors")


class Sensed(NamedTuple):
    """A sensor and the columns that it fed.

    Attributes
    ----------
    record : SensorRecord
        What its sheet says.
    columns : tuple of str
        In the file, in the order of the record's channels.
    sizes : tuple of Conversion
        From the units of the file to the one that the record expects.
    names : tuple of str
        What the columns are called afterwards.
    """

    record: SensorRecord
    columns: tuple[str, ...]
    sizes: tuple[Conversion, ...]
    names: tuple[str, ...]

    @property
    def note(self) -> str:
        """What was done, as a sentence."""
        named = ", ".join(map(repr, self.columns))
        return (
            f"--sensors: {named} {'is' if len(self.columns) == 1 else 'are'} turned from {self.record.raw_unit}"
            f" into {self.record.unit} by the sensor's sheet."
        )


class SensedRows:
    """Rows of which some columns are in what sensors measured.

    Parameters
    ----------
    rows : Rows
        As they are in the file; closed with these.
    sensed : sequence of Sensed
        Of different columns.
    decimal : str
        The decimal sign of numbers in text.
    """

    def __init__(self, rows: Rows, sensed: Sequence[Sensed], decimal: str) -> None:
        self._rows, self._decimal = rows, decimal
        self._by_name = {name: one for one in sensed for name in one.names}
        renamed = {
            own: (name, one.record.unit) for one in sensed for own, name in zip(one.columns, one.names, strict=True)
        }
        self._own = {new: own for own, (new, _) in renamed.items()}
        self.count: int = rows.count
        fields = [_field(field, *renamed[field.name]) if field.name in renamed else field for field in rows.schema]
        self.schema: pa.Schema = pa.schema(fields, metadata=rows.schema.metadata)

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Give the named columns from row `start` on, in blocks of up to `most_rows`."""
        needed = dict.fromkeys(own for name in names for own in self._needed(name))
        for block in self._rows.blocks(list(needed), most_rows, start):
            told: dict[str, Floats] = {}
            for one in {id(one): one for name in names if (one := self._by_name.get(name))}.values():
                told |= self._told(one, block)
            columns = [pa.array(told[name]) if name in told else block.column(name) for name in names]
            fields = [self.schema.field(name) for name in names]
            yield pa.table(columns, schema=pa.schema(fields, metadata=block.schema.metadata))

    def close(self) -> None:
        """Close the rows of the file."""
        self._rows.close()

    def _needed(self, name: str) -> tuple[str, ...]:
        return self._by_name[name].columns if name in self._by_name else (name,)

    def _told(self, one: Sensed, block: pa.Table) -> dict[str, Floats]:
        readings = [
            values_of(block.column(own), self._decimal) * size.factor + size.offset
            for own, size in zip(one.columns, one.sizes, strict=True)
        ]
        found = applied(one.record, dict(zip(one.record.channels, readings, strict=True)))
        return dict(zip(one.names, found.values(), strict=True))


def with_sensors(tables: Sequence[RawTable], options: ReadOptions) -> tuple[tuple[RawTable, ...], ReadOptions]:
    """Turn columns into what their sensors measured.

    Parameters
    ----------
    tables : sequence of RawTable
        A file.
    options : ReadOptions
        With the sensors; each must find its columns in one of the tables, in a unit that it can use.

    Returns
    -------
    tuple of RawTable
        With what was done among their notes.
    ReadOptions
        The same, but for channels that are called otherwise now.

    Raises
    ------
    UsageError
        If a column is not there, or in a unit that is no other size of the one the sensor expects.
    """
    found = [_found(tables, record) for record in options.sensors]
    carried = tuple(_carried(table, [one for holder, one in found if holder is table]) for table in tables)
    if options.channels is None:
        return carried, options
    renamed = {own: name for _, one in found for own, name in zip(one.columns, one.names, strict=True)}
    return carried, replace(options, channels=tuple(renamed.get(name, name) for name in options.channels))


def _found(tables: Sequence[RawTable], record: SensorRecord) -> tuple[RawTable, Sensed]:
    holding = [table for table in tables if all(holds(table, name) for name in record.channels)]
    if len(holding) != 1:
        named, where = ", ".join(map(repr, record.channels)), listed(tables)
        raise UsageError(
            f"--sensors names {named}, which {'no' if not holding else 'more than one'} time of the file"
            f" has together; it holds {where}."
        )
    (table,) = holding
    columns = tuple(named_column(table, name, SENSORS_OPTION) for name in record.channels)
    sizes = tuple(_size(table, column, record.raw_unit) for column in columns)
    return table, Sensed(record, columns, sizes, tuple(_named(table, column, record.unit) for column in columns))


def _size(table: RawTable, column: str, raw_unit: str) -> Conversion:
    told = unit_of(table, column)
    if told in ("", raw_unit):
        return Conversion()
    try:
        return conversion(told, raw_unit)
    except UsageError as cause:
        raise UsageError(f"--sensors expects {column!r} in {raw_unit}: {cause}") from cause


def _named(table: RawTable, column: str, unit: str) -> str:
    bare, in_header = parse_header(column)
    renamed = f"{bare} ({unit})" if in_header else column
    if renamed != column and renamed in table.names:
        raise UsageError(f"--sensors makes {column!r} {renamed!r}, and another column is called so; rename one.")
    return renamed


def _carried(table: RawTable, sensed: Sequence[Sensed]) -> RawTable:
    if not sensed:
        return table
    own = {name for one in sensed for name in one.columns}
    units = {name: unit for name, unit in table.units.items() if name not in own}
    units |= {name: one.record.unit for one in sensed for name in one.names}
    rows, notes = SensedRows(table.rows, sensed, table.decimal), (*table.notes, *(one.note for one in sensed))
    uncertain = {
        name: (share, one.record.offset_std)
        for one in sensed
        for name, share in zip(one.names, one.record.relative_stds, strict=True)
    }
    return replace(table, rows=rows, units=units, notes=notes, calibrations=uncertain)


def _field(field: pa.Field, name: str, unit: str) -> pa.Field:
    return pa.field(name, pa.float64(), metadata={**(field.metadata or {}), b"unit": unit.encode()})
