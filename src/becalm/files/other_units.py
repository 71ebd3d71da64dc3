"""Convert columns of a file to other units: those that the user requests, or those that a recipe needs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from becalm.errors import UsageError
from becalm.files.groups import holds, listed
from becalm.files.read_options import ReadOptions, RequestOrigin, RequiredUnits
from becalm.files.roles import SIGMA, unit_of
from becalm.files.rows import TableRows
from becalm.files.source import RawTable
from becalm.files.timing.time_column import is_time_name, named_column
from becalm.files.units.unit_conversion import Conversion, conversion
from becalm.files.units.unit_spelling import parse_header, tidy_unit

if TYPE_CHECKING:
    from becalm.sensors.record import Calibration

UNIT_OPTION = RequestOrigin("--unit")
SAME = Conversion()


class ColumnConversion(NamedTuple):
    """The new name and unit of a column, and the conversion to it.

    Attributes
    ----------
    name : str
        Its new name.
    unit : str
        Its new unit.
    conversion : Conversion
        The conversion from the unit of the file to the new unit.
    note : str
        A sentence for the user about the conversion; "" for none.
    """

    name: str
    unit: str
    conversion: Conversion
    note: str = ""


class ConvertedRows:
    """Rows of a file with some columns converted to other units.

    Parameters
    ----------
    rows : TableRows
        The rows as they are in the file; `close` closes them.
    columns : mapping of str to ColumnConversion
        The converted columns, by their names in the file; other columns are not changed.
    """

    def __init__(self, rows: TableRows, columns: Mapping[str, ColumnConversion]) -> None:
        self._rows = rows
        self._columns = {converted.name: (name, converted.conversion) for name, converted in columns.items()}
        self.count: int = rows.count
        fields = [_field(field, columns.get(field.name)) for field in rows.schema]
        self.schema: pa.Schema = pa.schema(fields, metadata=rows.schema.metadata)

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Yield the named columns from row `start` on, in blocks of up to `most_rows`."""
        own, conversions = zip(*(self._columns.get(name, (name, SAME)) for name in names), strict=True)
        fields = [self.schema.field(name) for name in names]
        for block in self._rows.blocks(own, most_rows, start):
            columns = list(map(_scaled, block.columns, conversions))
            yield pa.table(columns, schema=pa.schema(fields, metadata=block.schema.metadata))

    def close(self) -> None:
        """Close the rows of the file."""
        self._rows.close()


def convert_units(tables: Sequence[RawTable], options: ReadOptions) -> tuple[tuple[RawTable, ...], ReadOptions]:
    """Convert columns to the units that the user requests, then to those that a recipe needs.

    Parameters
    ----------
    tables : sequence of RawTable
        The tables of a file.
    options : ReadOptions
        Its `units` are the requested ones, its `required_units` those of a recipe.

    Returns
    -------
    tuple of RawTable
        The tables with converted columns; notes describe the conversions.
    ReadOptions
        The options, with the new names of channels that were renamed.

    Raises
    ------
    UsageError
        If a column is missing or is not numeric, or its unit cannot be converted.
    """
    selected = [table for table in tables if options.group in (None, table.group)]
    if options.units and selected:
        columns = _requested_conversions(selected, options.units)
        selected, options = [_convert(table, columns) for table in selected], _renamed(options, columns)
    if options.required_units is not None:
        columns = _needed_conversions(selected, options, options.required_units)
        selected = [_convert(table, columns) for table in selected]
        options = _renamed(options, columns)
    converted = iter(selected)
    return tuple(next(converted) if options.group in (None, table.group) else table for table in tables), options


def _requested_conversions(tables: Sequence[RawTable], units: Mapping[str, str]) -> dict[str, ColumnConversion]:
    """Return the conversion of each column that --unit names; a unit in its name is replaced by the new one."""
    columns: dict[str, ColumnConversion] = {}
    for requested, unit in units.items():
        holding = [table for table in tables if holds(table, requested)] or tables
        if len(holding) > 1:
            raise UsageError(f"--unit names {requested!r}, which is not one column; there are {listed(holding)}.")
        name, unit = named_column(holding[0], requested, UNIT_OPTION), tidy_unit(unit)
        if name in columns:
            raise UsageError(f"--unit names {name!r} twice; give it one unit.")
        old_unit = unit_of(holding[0], name)
        if old_unit not in ("", unit) and is_time_name(name):
            raise UsageError(f"--unit names {name!r}, a time, which becalm converts to seconds itself; leave it out.")
        bare, in_header = parse_header(name)
        renamed = f"{bare} ({unit})" if in_header and old_unit != unit else name
        columns[name] = _converted(holding[0], name, ColumnConversion(renamed, unit, SAME), UNIT_OPTION)
    return columns


def _needed_conversions(
    tables: Sequence[RawTable], options: ReadOptions, required: RequiredUnits
) -> dict[str, ColumnConversion]:
    """Return the conversions of columns to the names and units of a recipe; names are matched without their units."""
    owners = {name: table for table in tables for name in table.names}
    bare: dict[str, list[str]] = {}
    for name in owners:
        bare.setdefault(parse_header(name)[0], []).append(name)
    columns = {}
    for needed, unit in required.units.items():
        alike = [needed] if needed in owners else bare.get(parse_header(needed)[0], [])
        if len(alike) != 1 or not _is_wanted(alike[0], needed, options):
            continue  # a missing or ambiguous column is refused later, by `named_column`
        (name,) = alike
        old_unit = unit_of(owners[name], name)
        if old_unit and unit and (old_unit, name) != (unit, needed):
            columns[name] = _converted(owners[name], name, ColumnConversion(needed, unit, SAME), required.origin)
    return columns


def _is_wanted(name: str, needed: str, options: ReadOptions) -> bool:
    names = {name, needed, parse_header(name)[0]}
    return options.channels is None or any(channel.strip() in names for channel in options.channels)


def _converted(raw: RawTable, name: str, wanted: ColumnConversion, origin: RequestOrigin) -> ColumnConversion:
    """Return the wanted column with its conversion and a note for the user.

    Raises
    ------
    UsageError
        If the column cannot be converted.
    """
    old_unit, (renamed, unit, *_) = unit_of(raw, name), wanted
    if not old_unit:
        note = f"{origin.name}: the file has no unit for {name!r}; {unit} is assumed."
        return wanted._replace(note=note)
    try:
        factor, offset = change = conversion(old_unit, unit)
    except UsageError as cause:
        raise UsageError(f"{origin.name} asks for {name!r} in {unit}: {cause}{origin.advice}") from cause
    if change != SAME and not _is_number(raw.type_of(name)):
        raise UsageError(
            f"{origin.name} asks for {name!r} in {unit}, but not all of its cells are numbers (it holds"
            f" {raw.type_of(name)}); name a column of numbers, or correct this one."
        )
    if renamed != name and renamed in raw.names:
        raise UsageError(f"{origin.name} renames {name!r} to {renamed!r}, which another column is called; rename one.")
    if old_unit == unit:
        note = "" if renamed == name else f"{origin.name}: {name!r} is read as {renamed!r}."
        return wanted._replace(note=note)
    shift = f" {'+' if offset > 0 else '-'} {abs(offset):.6g}" if offset else ""
    note = f"{origin.name}: {name!r} is converted from {old_unit} to {unit} (times {factor:.6g}{shift})."
    return wanted._replace(conversion=change, note=note)


def _convert(raw: RawTable, columns: Mapping[str, ColumnConversion]) -> RawTable:
    """Return a table with converted columns and converted uncertainties."""
    own = {name: converted for name, converted in columns.items() if name in raw.names}
    if not own:
        return raw
    notes = tuple(converted.note for converted in own.values() if converted.note)
    for name, (renamed, unit, (factor, _), _) in tuple(own.items()):
        if name + SIGMA in raw.names and _is_number(raw.type_of(name + SIGMA)):
            own[name + SIGMA] = ColumnConversion(renamed + SIGMA, unit, Conversion(factor))
    units = {name: unit for name, unit in raw.units.items() if name not in own}
    units |= {converted.name: converted.unit for converted in own.values()}
    calibrations = {
        own[name].name if name in own else name: _scaled_calibration(name, one, own.get(name))
        for name, one in raw.calibrations.items()
    }
    rows = ConvertedRows(raw.rows, own)
    return replace(raw, rows=rows, units=units, notes=(*raw.notes, *notes), calibrations=calibrations)


def _scaled_calibration(name: str, calibration: Calibration, wanted: ColumnConversion | None) -> Calibration:
    change, unit = (SAME, "") if wanted is None else (wanted.conversion, wanted.unit)
    if change.offset and calibration.relative_std:
        raise UsageError(
            f"{name!r} cannot be converted to {unit}: its sensor file gives an uncertainty as a share of the result,"
            f" which depends on where the scale has its zero. Keep its unit, or write the sensor file in {unit}."
        )
    return calibration._replace(offset_std=calibration.offset_std * change.factor)


def _renamed(options: ReadOptions, columns: Mapping[str, ColumnConversion]) -> ReadOptions:
    """Return the options with the new names of the channels."""
    if options.channels is None:
        return options
    names = {name: converted.name for name, converted in columns.items()}
    return replace(options, channels=tuple(names.get(name, name) for name in options.channels))


def _scaled(column: pa.ChunkedArray, change: Conversion) -> pa.ChunkedArray:
    if change == SAME or pa.types.is_null(column.type):
        return column
    scaled = pc.multiply(column.cast(pa.float64(), safe=False), change.factor)
    return pc.add(scaled, change.offset) if change.offset else scaled


def _is_number(kind: pa.DataType) -> bool:
    numeric = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal, pa.types.is_null)
    return any(is_so(kind) for is_so in numeric)


def _field(field: pa.Field, converted: ColumnConversion | None) -> pa.Field:
    if converted is None:
        return field
    kept = converted.conversion == SAME or pa.types.is_null(field.type)
    metadata = {**(field.metadata or {}), b"unit": converted.unit.encode()}
    return pa.field(converted.name, field.type if kept else pa.float64(), metadata=metadata)
