"""Apply another calibration to a clean recording without cleaning it again.

A channel's filter is linear in its measurements, and its tuning and its gate scale with their unit. If the new
calibration turns measurements y into y' = a y + b, the clean signal x becomes a x + b, and the filter's sigma is
multiplied by |a|. The uncertainty of the old calibration is removed from sigma, and that of the new one is added, by
the formula in `becalm.cleaning.channels.judging`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.cleaning.recipes.recipe import Recipe
from becalm.cleaning.recipes.recipe_parts import CalibrationRecipe
from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.files.groups import holds, listed
from becalm.files.read_options import RequestOrigin
from becalm.files.roles import SIGMA, unit_of, values_of
from becalm.files.source import RawTable
from becalm.files.timing.time_column import named_column
from becalm.files.units.unit_spelling import parse_header
from becalm.sensors.bridge import Bridge
from becalm.sensors.curve import CalibrationCurve
from becalm.sensors.record import SensorRecord, apply_tare, convert_readings
from becalm.sensors.tare import Tare

_FROM = RequestOrigin("--from")
_AGAIN = "Clean the readings again, with the new sensors."
_LINE = 2  # number of coefficients of a straight line


class Recalibrated(NamedTuple):
    """The change of one channel by a new calibration.

    Attributes
    ----------
    column : str
        The column of the clean signal; the column of its uncertainty is `column` + "_sigma".
    factor, offset : float
        New value = factor * old value + offset, with the offset in the channel's unit.
    old, new : (float, float)
        Standard uncertainties (k = 1) of the old and the new calibration: of the sensitivity, as a fraction; of the
        zero, in the channel's unit.
    """

    column: str
    factor: float
    offset: float
    old: tuple[float, float]
    new: tuple[float, float]

    def recalibrate(self, signal: Floats, sigma: Floats) -> tuple[Floats, Floats]:
        """Return signal and sigma (n,) with the new calibration."""
        changed = self.factor * signal + self.offset
        variance = sigma**2 - (self.old[0] * signal) ** 2 - self.old[1] ** 2  # without the old calibration
        filtered = np.abs(self.factor) * np.sqrt(np.where(variance < 0, 0.0, variance))  # rounding can make it < 0
        return changed, np.sqrt(filtered**2 + (self.new[0] * changed) ** 2 + self.new[1] ** 2)


def recalibrated(
    tables: Sequence[RawTable], recipe: Recipe, old: Sequence[SensorRecord], new: Sequence[SensorRecord]
) -> tuple[tuple[Recalibrated, ...], ...]:
    """Compute how a new calibration changes the channels of a clean recording.

    Parameters
    ----------
    tables : sequence of RawTable
        The clean recording, one table per time base.
    recipe : Recipe
        The recipe that cleaned it.
    old, new : sequence of SensorRecord
        The old and the new calibration of the same channels.

    Returns
    -------
    tuple of tuple of Recalibrated
        The channels of each table.

    Raises
    ------
    UsageError
        If a channel of the old calibration is missing in the new one, the recording or the recipe, or if the raw
        readings are needed: for a sensor of several axes, a sensor that is not linear, another full scale or tare
        interval, an IMM, and split parts.
    """
    by_channels = {one.channels: one for one in new}
    missing = [one for one in old if one.channels not in by_channels]
    if missing or len(new) != len(old):
        odd = missing[0] if missing else next(one for one in new if one.channels not in {each.channels for each in old})
        raise UsageError(f"The sensor of {', '.join(odd.channels)} is in one of --from and --to only; both need it.")
    of_tables: list[list[Recalibrated]] = [[] for _ in tables]
    for one in old:
        place = _table_number(tables, one)
        of_tables[place].append(_recalibrate_channel(tables[place], recipe, one, by_channels[one.channels]))
    return tuple(map(tuple, of_tables))


def recalibrated_blocks(table: RawTable, channels: Sequence[Recalibrated]) -> Iterator[pa.Table]:
    """Yield all columns of a clean recording in blocks, with the new calibration applied to `channels`."""
    for block in table.blocks(table.names):
        for one in channels:
            names = (one.column, one.column + SIGMA)
            changed = one.recalibrate(*(values_of(block.column(name), table.decimal) for name in names))
            for name, values in zip(names, changed, strict=True):
                at = block.schema.get_field_index(name)
                block = block.set_column(at, block.schema.field(at).with_type(pa.float64()), pa.array(values))
        yield block


def _table_number(tables: Sequence[RawTable], record: SensorRecord) -> int:
    """Return the number of the table that has a sensor's channel; 0 if none has it, so that a later step raises."""
    holding = [place for place, table in enumerate(tables) if holds(table, record.channels[0])]
    if len(holding) > 1:
        raise UsageError(f"{record.channels[0]!r} is not one column; there are {listed(tables)}. Name it in full.")
    return holding[0] if holding else 0


def _recalibrate_channel(table: RawTable, recipe: Recipe, old: SensorRecord, new: SensorRecord) -> Recalibrated:
    _refuse_other(old, new)
    column = named_column(table, parse_header(old.channels[0])[0], _FROM)
    channel = next((one for one in recipe.channel if one.name == column), None)
    if channel is None or column + SIGMA not in table.names:
        raise UsageError(f"{column!r} was not cleaned: it is not in the recipe, or its sigma is missing. {_AGAIN}")
    if (unit := unit_of(table, column) or channel.unit) not in ("", old.unit):
        raise UsageError(f"{column!r} is in {unit}, but --from converts its readings to {old.unit}. {_AGAIN}")
    if channel.switching is not None:
        raise UsageError(
            f"The filter of {column!r} has several modes, so its signal is not linear in the readings. {_AGAIN}"
        )
    if split := [f"{column}_{part}" for part in channel.parts if f"{column}_{part}" in table.names]:
        raise UsageError(f"The file has parts of {column!r} ({split[0]!r}), which have no zero of their own. {_AGAIN}")
    calibration = channel.calibration
    tare = _tare_of(old, calibration)
    old, new = _with_zero(old, tare), _with_zero(new, tare)
    (slope, zero), (new_slope, new_zero) = _line(old), _line(new)
    factor = new_slope / slope
    return Recalibrated(
        column,
        factor,
        new_zero - factor * zero,
        (0.0, 0.0) if calibration is None else (calibration.relative_std, calibration.offset_std),
        (new.relative_stds[0], new.offset_std),
    )


def _refuse_other(old: SensorRecord, new: SensorRecord) -> None:
    """Refuse a new calibration that differs in more than the sensitivity and the zero of a linear sensor."""
    named = ", ".join(map(repr, old.channels))
    if len(old.channels) > 1:
        raise UsageError(f"The axes {named} are calibrated together, and each was filtered in its own way. {_AGAIN}")
    for one in (old, new):
        conversion = one.conversion
        if isinstance(conversion, Bridge) or (
            isinstance(conversion, CalibrationCurve) and len(conversion.coefficients) != _LINE
        ):
            raise UsageError(f"The sensor of {named} is not linear in its readings. {_AGAIN}")
    if (old.raw_unit, old.unit) != (new.raw_unit, new.unit):
        raise UsageError(
            f"The sensor of {named} converts {old.raw_unit} to {old.unit} in --from, and {new.raw_unit} to {new.unit}"
            " in --to; write both in the same units."
        )
    if new.tare_s not in (None, old.tare_s):
        raise UsageError(f"--to measures the zero of {named} in another interval than --from. {_AGAIN}")
    if old.full_scale != new.full_scale:
        raise UsageError(f"The sensor of {named} has another full scale, so other readings are clipped. {_AGAIN}")


def _tare_of(old: SensorRecord, calibration: CalibrationRecipe | None) -> Tare | None:
    """Return the zero that was measured at cleaning; raise an error if --from has another tare interval."""
    tare = None if calibration is None or calibration.tare is None else Tare(**calibration.tare.model_dump())
    expected = None if old.tare_s is None else (*old.tare_s, old.raw_unit)
    if expected != (None if tare is None else (tare.start_s, tare.stop_s, tare.raw_unit)):
        raise UsageError(
            f"--from and the recipe do not have the same zero of {old.channels[0]!r}: the recording was cleaned with"
            f" another sensor file. {_AGAIN}"
        )
    return tare


def _with_zero(record: SensorRecord, tare: Tare | None) -> SensorRecord:
    return record if record.tare_s is None or tare is None else apply_tare(record, tare)


def _line(record: SensorRecord) -> tuple[float, float]:
    """Return the slope of a linear sensor, and its result at a reading of 0."""
    (name,) = record.channels
    zero, one = convert_readings(replace(record, full_scale=None), {name: np.array([0.0, 1.0])})[name]
    return float(one - zero), float(zero)
