"""Convert columns of a file by the calibrations of their sensors while its rows are read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import pyarrow as pa

from becalm.core.arrays import Floats
from becalm.files.roles import values_of
from becalm.files.rows import TableRows
from becalm.files.units.unit_conversion import Conversion
from becalm.sensors.record import SensorRecord, convert_readings
from becalm.sensors.tare import Tare


class Thermometer(NamedTuple):
    """The column that holds a sensor's temperature.

    Attributes
    ----------
    column : str
        Its name; the new name if another sensor's calibration converts this column.
    size : Conversion
        Conversion from the column's unit to degC.
    """

    column: str
    size: Conversion


class MatchedSensor(NamedTuple):
    """A sensor and the columns of a file that hold its raw readings.

    Attributes
    ----------
    record : SensorRecord
        The sensor's calibration.
    columns : tuple of str
        Names in the file, in the order of the record's channels.
    sizes : tuple of Conversion
        Conversion of each column from its unit to the raw unit of the record.
    names : tuple of str
        Names of the converted columns.
    thermometer : Thermometer or None
        The temperature column, if the record has a temperature channel.
    tare : Tare or None
        The zero offset that was measured in the file; `record` already includes it.
    """

    record: SensorRecord
    columns: tuple[str, ...]
    sizes: tuple[Conversion, ...]
    names: tuple[str, ...]
    thermometer: Thermometer | None = None
    tare: Tare | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Return sentences for the user on the conversion and the measured zero."""
        named = ", ".join(map(repr, self.columns))
        converted = (
            f"--sensors: {named} {'is' if len(self.columns) == 1 else 'are'} converted from {self.record.raw_unit}"
            f" to {self.record.unit} by the sensor's data sheet{self._temperature_note()}."
        )
        if self.tare is None:
            return (converted,)
        start_s, stop_s, reading, _, raw_unit, readings, degc = self.tare
        temperature = "" if degc is None else f", at {degc:.4g} degC"
        return (
            converted,
            f"--sensors: the zero of {named} was measured from {start_s:g} s to {stop_s:g} s: {reading:.6g} {raw_unit},"
            f" the mean of {readings} readings{temperature}; its uncertainty is {self.record.zero_uncertainty:.3g}"
            f" {self.record.unit} (k = 2).",
        )

    def _temperature_note(self) -> str:
        temperature = self.record.temperature
        if temperature is None:
            return ""
        by = f"{temperature.constant_degc:g} degC" if self.thermometer is None else repr(self.thermometer.column)
        return f", and corrected for temperature by {by}"


class CalibratedRows:
    """Rows of a file whose sensor columns are converted to measured quantities.

    Parameters
    ----------
    rows : TableRows
        The rows as they are in the file; `close` closes them.
    sensed : sequence of MatchedSensor
        The sensors; no two share a column.
    decimal : str
        The decimal separator of numbers in text.
    """

    def __init__(self, rows: TableRows, sensed: Sequence[MatchedSensor], decimal: str) -> None:
        self._rows, self._decimal = rows, decimal
        self._by_name = {name: one for one in sensed for name in one.names}
        renamed = {
            own: (name, one.record.unit) for one in sensed for own, name in zip(one.columns, one.names, strict=True)
        }
        self.count: int = rows.count
        fields = [_field(field, *renamed[field.name]) if field.name in renamed else field for field in rows.schema]
        self.schema: pa.Schema = pa.schema(fields, metadata=rows.schema.metadata)

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Yield the named columns from row `start` on, in blocks of up to `most_rows`."""
        wanted = list(dict.fromkeys(each for name in names for each in self._with_thermometer(name)))
        needed = dict.fromkeys(own for name in wanted for own in self._columns_of(name))
        for block in self._rows.blocks(list(needed), most_rows, start):
            converted: dict[str, Floats] = {}
            for name in wanted:
                if name in self._by_name and name not in converted:
                    converted |= self._convert(self._by_name[name], block, converted)
            columns = [pa.array(converted[name]) if name in converted else block.column(name) for name in names]
            fields = [self.schema.field(name) for name in names]
            yield pa.table(columns, schema=pa.schema(fields, metadata=block.schema.metadata))

    def close(self) -> None:
        """Close the rows of the file."""
        self._rows.close()

    def _with_thermometer(self, name: str) -> tuple[str, ...]:
        """Return a column's name, preceded by the name of its temperature column if it has one."""
        one = self._by_name.get(name)
        return (name,) if one is None or one.thermometer is None else (one.thermometer.column, name)

    def _columns_of(self, name: str) -> tuple[str, ...]:
        return self._by_name[name].columns if name in self._by_name else (name,)

    def _convert(self, one: MatchedSensor, block: pa.Table, converted: dict[str, Floats]) -> dict[str, Floats]:
        """Return the converted columns of one sensor by new name; `converted` has the columns converted before."""
        readings = [
            self._values(block, own) * size.factor + size.offset
            for own, size in zip(one.columns, one.sizes, strict=True)
        ]
        if one.thermometer is not None:
            name, size = one.thermometer
            values = converted[name] if name in converted else self._values(block, name)
            readings.append(values * size.factor + size.offset)
        measured = convert_readings(one.record, dict(zip(one.record.needed, readings, strict=True)))
        return dict(zip(one.names, measured.values(), strict=True))

    def _values(self, block: pa.Table, name: str) -> Floats:
        return values_of(block.column(name), self._decimal)


def _field(field: pa.Field, name: str, unit: str) -> pa.Field:
    return pa.field(name, pa.float64(), metadata={**(field.metadata or {}), b"unit": unit.encode()})
