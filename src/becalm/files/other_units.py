"""Columns in other units than the file has them: as a person asks, or as a recipe needs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from becalm.errors import UsageError
from becalm.files.read_options import Asker, Fitting, ReadOptions
from becalm.files.roles import SIGMA, unit_of
from becalm.files.rows import TableRows
from becalm.files.source import RawTable
from becalm.files.time_base_choice import holds, listed
from becalm.files.timing.time_column import is_time_name, named_column
from becalm.files.unit_conversion import Conversion, conversion
from becalm.files.unit_spelling import parse_header, tidy_unit
from becalm.sensors.record import Calibration

UNIT_OPTION = Asker("--unit")
SAME = Conversion()


class Converted(NamedTuple):
    """A column as it is to be given.

    Attributes
    ----------
    name : str
        What it is called then.
    unit : str
        What it is in then.
    conversion : Conversion
        From the unit of the file.
    note : str
        What a person must know of it, as a sentence; "" for nothing.
    """

    name: str
    unit: str
    conversion: Conversion
    note: str = ""


class ConvertedRows:
    """Rows of which some columns are in other units.

    Parameters
    ----------
    rows : TableRows
        As they are in the file; closed with these.
    columns : mapping of str to Converted
        By the names in the file; the others stay as they are.
    """

    def __init__(self, rows: TableRows, columns: Mapping[str, Converted]) -> None:
        self._rows = rows
        self._columns = {converted.name: (name, converted.conversion) for name, converted in columns.items()}
        self.count: int = rows.count
        fields = [_field(field, columns.get(field.name)) for field in rows.schema]
        self.schema: pa.Schema = pa.schema(fields, metadata=rows.schema.metadata)

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Give the named columns from row `start` on, in blocks of up to `most_rows`."""
        own, factors = zip(*(self._columns.get(name, (name, SAME)) for name in names), strict=True)
        fields = [self.schema.field(name) for name in names]
        for block in self._rows.blocks(own, most_rows, start):
            columns = list(map(_scaled, block.columns, factors))
            yield pa.table(columns, schema=pa.schema(fields, metadata=block.schema.metadata))

    def close(self) -> None:
        """Close the rows of the file."""
        self._rows.close()


def in_units_asked(tables: Sequence[RawTable], options: ReadOptions) -> tuple[tuple[RawTable, ...], ReadOptions]:
    """Convert columns to the units that a person asked for, then to those that a recipe needs.

    Parameters
    ----------
    tables : sequence of RawTable
        A file.
    options : ReadOptions
        What was asked, and needed.

    Returns
    -------
    tuple of RawTable
        With what was done among their notes.
    ReadOptions
        The same, but for channels that are called otherwise now.

    Raises
    ------
    UsageError
        If a column is not there or not of numbers, or its unit cannot be converted.
    """
    meant = [table for table in tables if options.group in (None, table.group)]
    if options.units and meant:
        columns = _asked(meant, options.units)
        meant, options = [_carried(table, columns) for table in meant], _renamed(options, columns)
    if options.fitting is not None:
        columns = _needed(meant, options, options.fitting)
        meant = [_carried(table, columns) for table in meant]
        options = _renamed(options, columns)
    given = iter(meant)
    return tuple(next(given) if options.group in (None, table.group) else table for table in tables), options


def _asked(tables: Sequence[RawTable], units: Mapping[str, str]) -> dict[str, Converted]:
    """Return each column that was named, under the name that tells its new unit."""
    columns: dict[str, Converted] = {}
    for asked, unit in units.items():
        holding = [table for table in tables if holds(table, asked)] or tables
        if len(holding) > 1:
            raise UsageError(f"--unit names {asked!r}, which is no one column; there are {listed(holding)}.")
        name, unit = named_column(holding[0], asked, UNIT_OPTION), tidy_unit(unit)
        if name in columns:
            raise UsageError(f"--unit names {name!r} twice; give it one unit.")
        told = unit_of(holding[0], name)
        if told not in ("", unit) and is_time_name(name):
            raise UsageError(f"--unit names {name!r}, which is a time; it is read in seconds by itself. Leave it out.")
        bare, in_header = parse_header(name)
        renamed = f"{bare} ({unit})" if in_header and told != unit else name
        columns[name] = _converted(holding[0], name, Converted(renamed, unit, SAME), UNIT_OPTION)
    return columns


def _needed(tables: Sequence[RawTable], options: ReadOptions, fitting: Fitting) -> dict[str, Converted]:
    """Return columns whose bare names are those of a recipe, in its units and under its names."""
    owners = {name: table for table in tables for name in table.names}
    bare: dict[str, list[str]] = {}
    for name in owners:
        bare.setdefault(parse_header(name)[0], []).append(name)
    columns = {}
    for needed, unit in fitting.units.items():
        alike = [needed] if needed in owners else bare.get(parse_header(needed)[0], [])
        if len(alike) != 1 or not _is_wanted(alike[0], needed, options):
            continue  # whoever looks for the column says that it is not there
        (name,) = alike
        told = unit_of(owners[name], name)
        if told and unit and (told, name) != (unit, needed):
            columns[name] = _converted(owners[name], name, Converted(needed, unit, SAME), fitting.asker)
    return columns


def _is_wanted(name: str, needed: str, options: ReadOptions) -> bool:
    names = {name, needed, parse_header(name)[0]}
    return options.channels is None or any(asked.strip() in names for asked in options.channels)


def _converted(raw: RawTable, name: str, wanted: Converted, asker: Asker) -> Converted:
    """Return how a column becomes the one wanted, and say so.

    Raises
    ------
    UsageError
        If it cannot.
    """
    told, (renamed, unit, *_) = unit_of(raw, name), wanted
    if not told:
        note = f"{asker.name}: the file does not tell the unit of {name!r}; it is taken to be {unit}."
        return wanted._replace(note=note)
    try:
        factor, offset = found = conversion(told, unit)
    except UsageError as cause:
        raise UsageError(f"{asker.name} wants {name!r} in {unit}: {cause}{asker.way_out}") from cause
    if found != SAME and not _is_number(raw.type_of(name)):
        raise UsageError(
            f"{asker.name} wants {name!r} in {unit}, but not all of its cells are numbers (it holds"
            f" {raw.type_of(name)}); name a column of numbers, or mend this one."
        )
    if renamed != name and renamed in raw.names:
        raise UsageError(f"{asker.name} makes {name!r} {renamed!r}, and another column is called so; rename one.")
    if told == unit:
        note = "" if renamed == name else f"{asker.name}: {name!r} is read as {renamed!r}."
        return wanted._replace(note=note)
    shift = f" {'+' if offset > 0 else '-'} {abs(offset):.6g}" if offset else ""
    note = f"{asker.name}: {name!r} is converted from {told} to {unit} (times {factor:.6g}{shift})."
    return wanted._replace(conversion=found, note=note)


def _carried(raw: RawTable, columns: Mapping[str, Converted]) -> RawTable:
    """Return a table with its converted columns, and their uncertainties."""
    own = {name: converted for name, converted in columns.items() if name in raw.names}
    if not own:
        return raw
    notes = tuple(converted.note for converted in own.values() if converted.note)
    for name, (renamed, unit, (factor, _), _) in tuple(own.items()):
        if name + SIGMA in raw.names and _is_number(raw.type_of(name + SIGMA)):
            own[name + SIGMA] = Converted(renamed + SIGMA, unit, Conversion(factor))
    units = {name: unit for name, unit in raw.units.items() if name not in own}
    units |= {converted.name: converted.unit for converted in own.values()}
    uncertain = {
        own[name].name if name in own else name: _scaled_zero(one, own[name].conversion if name in own else SAME)
        for name, one in raw.calibrations.items()
    }
    rows = ConvertedRows(raw.rows, own)
    return replace(raw, rows=rows, units=units, notes=(*raw.notes, *notes), calibrations=uncertain)


def _scaled_zero(calibration: Calibration, size: Conversion) -> Calibration:
    if size.offset and calibration.relative_std:
        raise UsageError(
            "A sensor's sheet tells how uncertain a sensitivity is as a share of the result, which is another share on"
            " another scale of temperature; leave the unit as the sheet has it, or write the sensor for the other."
        )
    return calibration._replace(offset_std=calibration.offset_std * size.factor)


def _renamed(options: ReadOptions, columns: Mapping[str, Converted]) -> ReadOptions:
    """Return options whose channels are called as the columns are now."""
    if options.channels is None:
        return options
    names = {name: converted.name for name, converted in columns.items()}
    return replace(options, channels=tuple(names.get(name, name) for name in options.channels))


def _scaled(column: pa.ChunkedArray, factors: Conversion) -> pa.ChunkedArray:
    if factors == SAME or pa.types.is_null(column.type):
        return column
    scaled = pc.multiply(column.cast(pa.float64(), safe=False), factors.factor)
    return pc.add(scaled, factors.offset) if factors.offset else scaled


def _is_number(kind: pa.DataType) -> bool:
    numeric = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal, pa.types.is_null)
    return any(is_so(kind) for is_so in numeric)


def _field(field: pa.Field, converted: Converted | None) -> pa.Field:
    if converted is None:
        return field
    kept = converted.conversion == SAME or pa.types.is_null(field.type)
    metadata = {**(field.metadata or {}), b"unit": converted.unit.encode()}
    return pa.field(converted.name, field.type if kept else pa.float64(), metadata=metadata)
