"""Rows of a file with some columns converted by their sensors' calibrations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import pyarrow as pa

from becalm.core.arrays import Floats
from becalm.files.roles import values_of
from becalm.files.rows import TableRows
from becalm.files.unit_conversion import Conversion
from becalm.sensors.record import SensorRecord, applied
from becalm.sensors.tare import Tare


class Thermometer(NamedTuple):
    """A column that tells a sensor's temperature.

    Attributes
    ----------
    column : str
        As it is called once its own sensor, if it has one, turned it into its unit.
    size : Conversion
        From its unit to degC.
    """

    column: str
    size: Conversion


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
    thermometer : Thermometer or None
        Where the record has a channel of temperature.
    tare : Tare or None
        The zero that was taken, and is in the record.
    """

    record: SensorRecord
    columns: tuple[str, ...]
    sizes: tuple[Conversion, ...]
    names: tuple[str, ...]
    thermometer: Thermometer | None = None
    tare: Tare | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done, as sentences."""
        named = ", ".join(map(repr, self.columns))
        turned = (
            f"--sensors: {named} {'is' if len(self.columns) == 1 else 'are'} turned from {self.record.raw_unit}"
            f" into {self.record.unit} by the sensor's sheet{self._corrected()}."
        )
        if self.tare is None:
            return (turned,)
        start_s, stop_s, reading, _, raw_unit, readings, degc = self.tare
        warm = "" if degc is None else f", at {degc:.4g} degC"
        return (
            turned,
            f"--sensors: the zero of {named} was taken from {start_s:g} s to {stop_s:g} s: {reading:.6g} {raw_unit},"
            f" the mean of {readings} readings{warm}; it is uncertain by {self.record.zero_uncertainty:.3g}"
            f" {self.record.unit} (k = 2).",
        )

    def _corrected(self) -> str:
        temperature = self.record.temperature
        if temperature is None:
            return ""
        by = f"{temperature.constant_degc:g} degC" if self.thermometer is None else repr(self.thermometer.column)
        return f", and corrected for temperature by {by}"


class SensedRows:
    """Rows of which some columns are in what sensors measured.

    Parameters
    ----------
    rows : TableRows
        As they are in the file; closed with these.
    sensed : sequence of Sensed
        Of different columns.
    decimal : str
        The decimal sign of numbers in text.
    """

    def __init__(self, rows: TableRows, sensed: Sequence[Sensed], decimal: str) -> None:
        self._rows, self._decimal = rows, decimal
        self._by_name = {name: one for one in sensed for name in one.names}
        renamed = {
            own: (name, one.record.unit) for one in sensed for own, name in zip(one.columns, one.names, strict=True)
        }
        self.count: int = rows.count
        fields = [_field(field, *renamed[field.name]) if field.name in renamed else field for field in rows.schema]
        self.schema: pa.Schema = pa.schema(fields, metadata=rows.schema.metadata)

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Give the named columns from row `start` on, in blocks of up to `most_rows`."""
        wanted = list(dict.fromkeys(each for name in names for each in self._with_thermometer(name)))
        needed = dict.fromkeys(own for name in wanted for own in self._columns_of(name))
        for block in self._rows.blocks(list(needed), most_rows, start):
            told: dict[str, Floats] = {}
            for name in wanted:
                if name in self._by_name and name not in told:
                    told |= self._told(self._by_name[name], block, told)
            columns = [pa.array(told[name]) if name in told else block.column(name) for name in names]
            fields = [self.schema.field(name) for name in names]
            yield pa.table(columns, schema=pa.schema(fields, metadata=block.schema.metadata))

    def close(self) -> None:
        """Close the rows of the file."""
        self._rows.close()

    def _with_thermometer(self, name: str) -> tuple[str, ...]:
        """Return a column, after the one that tells its temperature."""
        one = self._by_name.get(name)
        return (name,) if one is None or one.thermometer is None else (one.thermometer.column, name)

    def _columns_of(self, name: str) -> tuple[str, ...]:
        return self._by_name[name].columns if name in self._by_name else (name,)

    def _told(self, one: Sensed, block: pa.Table, told: dict[str, Floats]) -> dict[str, Floats]:
        readings = [
            self._values(block, own) * size.factor + size.offset
            for own, size in zip(one.columns, one.sizes, strict=True)
        ]
        if one.thermometer is not None:
            name, size = one.thermometer
            values = told[name] if name in told else self._values(block, name)
            readings.append(values * size.factor + size.offset)
        found = applied(one.record, dict(zip(one.record.needed, readings, strict=True)))
        return dict(zip(one.names, found.values(), strict=True))

    def _values(self, block: pa.Table, name: str) -> Floats:
        return values_of(block.column(name), self._decimal)


def _field(field: pa.Field, name: str, unit: str) -> pa.Field:
    return pa.field(name, pa.float64(), metadata={**(field.metadata or {}), b"unit": unit.encode()})
