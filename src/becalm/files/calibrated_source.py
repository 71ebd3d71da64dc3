"""A source with columns converted from volts by their sensors' calibrations."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace

from becalm.errors import UsageError
from becalm.files.calibrated_rows import Sensed, SensedRows, Thermometer
from becalm.files.read_options import Asker, ReadOptions
from becalm.files.roles import refuse_no_numbers, unit_of
from becalm.files.source import RawTable
from becalm.files.taring import with_tares
from becalm.files.time_base_choice import holds, listed
from becalm.files.timing.time_column import named_column
from becalm.files.unit_conversion import Conversion, conversion
from becalm.files.unit_spelling import parse_header
from becalm.sensors.record import Calibration, SensorRecord

SENSORS_OPTION = Asker("--sensors")
DEGC = "degC"


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
        If a column is not there, named by two sensors, or in a unit that is no other size of the one that the sensor
        expects.
    InputError
        If a column holds no numbers.
    SensorError
        If a stretch from which a zero is to be taken is not quiet.
    """
    found = [_found(tables, record) for record in options.sensors]
    for table in tables:
        _refuse_twice([one for holder, one in found if holder is table])
    carried = tuple(_carried(table, [one for holder, one in found if holder is table], options) for table in tables)
    if options.channels is None:
        return carried, options
    renamed = {own: name for _, one in found for own, name in zip(one.columns, one.names, strict=True)}
    return carried, replace(options, channels=tuple(renamed.get(name, name) for name in options.channels))


def _found(tables: Sequence[RawTable], record: SensorRecord) -> tuple[RawTable, Sensed]:
    holding = [table for table in tables if all(holds(table, name) for name in record.needed)]
    if len(tables) == 1:
        holding = list(tables)  # whoever looks for the column says which there are
    if len(holding) != 1:
        named, where = ", ".join(map(repr, record.needed)), listed(tables)
        raise UsageError(
            f"--sensors names {named}, which {'no' if not holding else 'more than one'} time of the file"
            f" has together; it holds {where}."
        )
    (table,) = holding
    columns = tuple(named_column(table, name, SENSORS_OPTION) for name in record.channels)
    sizes = tuple(_size(table, column, record.raw_unit) for column in columns)
    return table, Sensed(record, columns, sizes, tuple(_named(table, column, record.unit) for column in columns))


def _refuse_twice(found: Sequence[Sensed]) -> None:
    """Refuse a column that two sensors turn, by whichever of its names, and two that would be called alike."""
    columns = [column for one in found for column in one.columns]
    names = [name for one in found for name in one.names]
    for at, (column, name) in enumerate(zip(columns, names, strict=True)):
        if column in columns[:at]:
            raise UsageError(f"--sensors names {column!r} twice; a channel has one sensor.")
        if name in names[:at]:
            other = columns[names.index(name)]
            raise UsageError(f"--sensors makes both {other!r} and {column!r} {name!r}; rename one in the file.")


def _with_thermometer(table: RawTable, one: Sensed, others: Sequence[Sensed]) -> Sensed:
    """Find the column that tells a sensor's temperature, which may have a sensor of its own."""
    channel = None if one.record.temperature is None else one.record.temperature.channel
    if channel is None:
        return one
    column = named_column(table, channel, SENSORS_OPTION)
    for other in others:
        if column in other.columns:
            if other.record.tare_s is not None:
                raise UsageError(f"--sensors: {column!r} tells a temperature, whose zero is no load's; leave tare out.")
            named = other.names[other.columns.index(column)]
            return one._replace(thermometer=Thermometer(named, _conversion(column, other.record.unit, DEGC)))
    return one._replace(thermometer=Thermometer(column, _size(table, column, DEGC)))


def _size(table: RawTable, column: str, raw_unit: str) -> Conversion:
    refuse_no_numbers(table, column, ())
    return _conversion(column, unit_of(table, column) or raw_unit, raw_unit)


def _conversion(column: str, told: str, wanted: str) -> Conversion:
    if told == wanted:
        return Conversion()
    try:
        return conversion(told, wanted)
    except UsageError as cause:
        raise UsageError(f"--sensors expects {column!r} in {wanted}: {cause}") from cause


def _named(table: RawTable, column: str, unit: str) -> str:
    bare, in_header = parse_header(column)
    renamed = f"{bare} ({unit})" if in_header else column
    if renamed != column and renamed in table.names:
        raise UsageError(f"--sensors makes {column!r} {renamed!r}, and another column is called so; rename one.")
    return renamed


def _carried(table: RawTable, found: Sequence[Sensed], options: ReadOptions) -> RawTable:
    if not found:
        return table
    sensed = with_tares(table, [_with_thermometer(table, one, found) for one in found], options)
    own = {name for one in sensed for name in one.columns}
    units = {name: unit for name, unit in table.units.items() if name not in own}
    units |= {name: one.record.unit for one in sensed for name in one.names}
    rows = SensedRows(table.rows, sensed, table.decimal)
    notes = (*table.notes, *(note for one in sensed for note in (*one.notes, *_taken_for(table, one, own))))
    uncertain = {
        name: Calibration(share, one.record.offset_std, one.tare, one.record.sheet.resonance)
        for one in sensed
        for name, share in zip(one.names, one.record.relative_stds, strict=True)
    }
    return replace(table, rows=rows, units=units, notes=notes, calibrations=uncertain)


def _taken_for(table: RawTable, one: Sensed, sensed: Container[str]) -> tuple[str, ...]:
    """Say of columns whose unit the file does not tell what they are taken to be in."""
    read = [(one.columns, one.record.raw_unit)]
    if one.thermometer is not None and one.thermometer.column in table.names and one.thermometer.column not in sensed:
        read.append(((one.thermometer.column,), DEGC))
    untold = [([name for name in names if not unit_of(table, name)], unit) for names, unit in read]
    return tuple(
        f"--sensors: the file does not tell the unit of {', '.join(map(repr, names))}; it is taken to be {unit}."
        for names, unit in untold
        if names
    )
