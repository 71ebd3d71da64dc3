"""Match sensors with the columns of a file, and convert those columns by the sensors' calibrations."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace

from becalm.errors import UsageError
from becalm.files.calibrated.calibrated_rows import CalibratedRows, MatchedSensor, Thermometer
from becalm.files.calibrated.taring import measure_tares
from becalm.files.groups import holds, listed
from becalm.files.read_options import ReadOptions, RequestOrigin
from becalm.files.roles import refuse_no_numbers, unit_of
from becalm.files.source import RawTable
from becalm.files.timing.time_column import named_column
from becalm.files.units.unit_conversion import Conversion, conversion
from becalm.files.units.unit_spelling import parse_header
from becalm.sensors.record import Calibration, SensorRecord

SENSORS_OPTION = RequestOrigin("--sensors")
DEGC = "degC"


def with_sensors(tables: Sequence[RawTable], options: ReadOptions) -> tuple[tuple[RawTable, ...], ReadOptions]:
    """Convert the sensor columns of a file from raw readings to measured quantities.

    Parameters
    ----------
    tables : sequence of RawTable
        The tables of a file.
    options : ReadOptions
        Its `sensors` are used. All columns of a sensor must be in the same table, in units that convert to the raw
        unit of the sensor.

    Returns
    -------
    tuple of RawTable
        The tables with converted columns; notes describe the conversions.
    ReadOptions
        The options, with the new names of channels that were renamed.

    Raises
    ------
    UsageError
        If a column is missing, is named by two sensors, would get the name of another column, or has a unit that
        cannot be converted to the sensor's.
    InputError
        If a column does not hold numbers, or the time of a tare interval cannot be interpreted.
    SensorError
        If a zero cannot be measured in the given interval: see `measure_tares`.
    """
    matches = [_match(tables, record) for record in options.sensors]
    for table in tables:
        _refuse_duplicates([one for holder, one in matches if holder is table])
    converted = tuple(_convert(table, [one for holder, one in matches if holder is table], options) for table in tables)
    if options.channels is None:
        return converted, options
    renamed = {own: name for _, one in matches for own, name in zip(one.columns, one.names, strict=True)}
    return converted, replace(options, channels=tuple(renamed.get(name, name) for name in options.channels))


def _match(tables: Sequence[RawTable], record: SensorRecord) -> tuple[RawTable, MatchedSensor]:
    """Return the table that holds the columns of a sensor, and the sensor with the names of these columns."""
    holding = [table for table in tables if all(holds(table, name) for name in record.needed)]
    if len(tables) == 1:
        holding = list(tables)  # if the column is missing, `named_column` raises and lists the columns of the file
    if len(holding) != 1:
        named, where = ", ".join(map(repr, record.needed)), listed(tables)
        raise UsageError(
            f"--sensors names {named}, which {'no' if not holding else 'more than one'} time base of the file"
            f" has together; it holds {where}."
        )
    (table,) = holding
    columns = tuple(named_column(table, name, SENSORS_OPTION) for name in record.channels)
    sizes = tuple(_size(table, column, record.raw_unit) for column in columns)
    return table, MatchedSensor(
        record, columns, sizes, tuple(_new_name(table, column, record.unit) for column in columns)
    )


def _refuse_duplicates(sensed: Sequence[MatchedSensor]) -> None:
    """Refuse a column that belongs to two sensors, and two columns that would get the same new name."""
    columns = [column for one in sensed for column in one.columns]
    names = [name for one in sensed for name in one.names]
    for at, (column, name) in enumerate(zip(columns, names, strict=True)):
        if column in columns[:at]:
            raise UsageError(f"--sensors names {column!r} twice; a channel has one sensor.")
        if name in names[:at]:
            other = columns[names.index(name)]
            raise UsageError(f"--sensors makes both {other!r} and {column!r} {name!r}; rename one in the file.")


def _with_thermometer(table: RawTable, one: MatchedSensor, others: Sequence[MatchedSensor]) -> MatchedSensor:
    """Return a sensor with its temperature column, if it needs one; another sensor may calibrate that column."""
    channel = None if one.record.temperature is None else one.record.temperature.channel
    if channel is None:
        return one
    column = named_column(table, channel, SENSORS_OPTION)
    for other in others:
        if column in other.columns:
            if other.record.tare_s is not None:
                raise UsageError(f"--sensors: {column!r} is a temperature, whose zero cannot be tared; leave tare out.")
            named = other.names[other.columns.index(column)]
            return one._replace(thermometer=Thermometer(named, _conversion(column, other.record.unit, DEGC)))
    return one._replace(thermometer=Thermometer(column, _size(table, column, DEGC)))


def _size(table: RawTable, column: str, raw_unit: str) -> Conversion:
    """Return the conversion of a column from its unit in the file to the raw unit of its sensor."""
    refuse_no_numbers(table, column, ())
    return _conversion(column, unit_of(table, column) or raw_unit, raw_unit)


def _conversion(column: str, unit: str, wanted: str) -> Conversion:
    if unit == wanted:
        return Conversion()
    try:
        return conversion(unit, wanted)
    except UsageError as cause:
        raise UsageError(f"--sensors expects {column!r} in {wanted}: {cause}") from cause


def _new_name(table: RawTable, column: str, unit: str) -> str:
    bare, in_header = parse_header(column)
    renamed = f"{bare} ({unit})" if in_header else column
    if renamed != column and renamed in table.names:
        raise UsageError(f"--sensors renames {column!r} to {renamed!r}, but another column has that name; rename one.")
    return renamed


def _convert(table: RawTable, matches: Sequence[MatchedSensor], options: ReadOptions) -> RawTable:
    if not matches:
        return table
    sensed = measure_tares(table, [_with_thermometer(table, one, matches) for one in matches], options)
    own = {name for one in sensed for name in one.columns}
    units = {name: unit for name, unit in table.units.items() if name not in own}
    units |= {name: one.record.unit for one in sensed for name in one.names}
    rows = CalibratedRows(table.rows, sensed, table.decimal)
    notes = (*table.notes, *(note for one in sensed for note in (*one.notes, *_assumed_units(table, one, own))))
    calibrations = {
        name: Calibration(share, one.record.offset_std, one.tare, one.record.sheet.resonance)
        for one in sensed
        for name, share in zip(one.names, one.record.relative_stds, strict=True)
    }
    return replace(table, rows=rows, units=units, notes=notes, calibrations=calibrations)


def _assumed_units(table: RawTable, one: MatchedSensor, sensed: Container[str]) -> tuple[str, ...]:
    """Return a note for columns without a unit in the file, with the unit that is assumed."""
    columns = [(one.columns, one.record.raw_unit)]
    if one.thermometer is not None and one.thermometer.column in table.names and one.thermometer.column not in sensed:
        columns.append(((one.thermometer.column,), DEGC))
    without_unit = [([name for name in names if not unit_of(table, name)], unit) for names, unit in columns]
    return tuple(
        f"--sensors: the file has no unit for {', '.join(map(repr, names))}; {unit} is assumed."
        for names, unit in without_unit
        if names
    )
