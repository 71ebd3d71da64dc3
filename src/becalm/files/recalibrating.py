"""A clean recording as it would be with another calibration, where its filter is the same but for size and zero.

A channel's filter is linear in its readings, and what tunes and gates it is in their unit; so readings that are turned
into y' = a y + b by the new sheet give the signal a x + b, and the filter's sigma times |a|. What the old sheet left
uncertain is taken out of sigma, and the new one's put in (`becalm.cleaning.uncertainty`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from becalm.cleaning.recipe import Recipe
from becalm.cleaning.recipe_parts import CalibrationRecipe
from becalm.core.arrays import Floats
from becalm.errors import UsageError
from becalm.files.read_options import Asker
from becalm.files.roles import SIGMA, unit_of, values_of
from becalm.files.source import RawTable
from becalm.files.time_base_choice import holds, listed
from becalm.files.timing.time_column import named_column
from becalm.files.unit_spelling import parse_header
from becalm.sensors.bridge import Bridge
from becalm.sensors.curve import CalibrationCurve
from becalm.sensors.record import SensorRecord, applied, tared
from becalm.sensors.tare import Tare

_FROM = Asker("--from")
_AGAIN = "Clean the readings again, with the new sensors."
_LINE = 2  # coefficients of a curve that is a straight line


class Recalibrated(NamedTuple):
    """One channel, and what its new calibration makes of it.

    Attributes
    ----------
    column : str
        Of the clean signal; its uncertainty stands in `column` + "_sigma".
    factor, offset : float
        New value = factor * old value + offset, the offset in the channel's unit.
    old, new : (float, float)
        Standard uncertainties (k = 1): of the sensitivity, as a share; of the zero, in unit.
    """

    column: str
    factor: float
    offset: float
    old: tuple[float, float]
    new: tuple[float, float]

    def told(self, signal: Floats, sigma: Floats) -> tuple[Floats, Floats]:
        """Return signal and sigma (n,) with the new calibration."""
        changed = self.factor * signal + self.offset
        own = sigma**2 - (self.old[0] * signal) ** 2 - self.old[1] ** 2
        filtered = np.abs(self.factor) * np.sqrt(np.where(own < 0, 0.0, own))  # below 0 by rounding in the file
        return changed, np.sqrt(filtered**2 + (self.new[0] * changed) ** 2 + self.new[1] ** 2)


def recalibrated(
    tables: Sequence[RawTable], recipe: Recipe, old: Sequence[SensorRecord], new: Sequence[SensorRecord]
) -> tuple[tuple[Recalibrated, ...], ...]:
    """Find what a new calibration makes of the channels of a clean recording.

    Parameters
    ----------
    tables : sequence of RawTable
        The clean recording, one or more times.
    recipe : Recipe
        That it was cleaned by.
    old, new : sequence of SensorRecord
        The calibrations, of the same channels.

    Returns
    -------
    tuple of tuple of Recalibrated
        The channels of each table.

    Raises
    ------
    UsageError
        If a channel of the old calibration is not in the new one, the recording or the recipe, or it cannot be had
        without the readings: of a sensor of several axes, one that is not linear, a filter that switches, and parts
        that were split.
    """
    by_channels = {one.channels: one for one in new}
    missing = [one for one in old if one.channels not in by_channels]
    if missing or len(new) != len(old):
        odd = missing[0] if missing else next(one for one in new if one.channels not in {each.channels for each in old})
        raise UsageError(f"The sensor of {', '.join(odd.channels)} is in one of --from and --to only; both need it.")
    of_tables: list[list[Recalibrated]] = [[] for _ in tables]
    for one in old:
        place = _place(tables, one)
        of_tables[place].append(_of_channel(tables[place], recipe, one, by_channels[one.channels]))
    return tuple(map(tuple, of_tables))


def recalibrated_blocks(table: RawTable, channels: Sequence[Recalibrated]) -> Iterator[pa.Table]:
    """Give all columns of a clean recording in blocks, those of the channels with their new calibration."""
    for block in table.blocks(table.names):
        for one in channels:
            names = (one.column, one.column + SIGMA)
            told = one.told(*(values_of(block.column(name), table.decimal) for name in names))
            for name, values in zip(names, told, strict=True):
                at = block.schema.get_field_index(name)
                block = block.set_column(at, block.schema.field(at).with_type(pa.float64()), pa.array(values))
        yield block


def _place(tables: Sequence[RawTable], record: SensorRecord) -> int:
    """Return which table has a sensor's channel; the first where none has, which then says so."""
    holding = [place for place, table in enumerate(tables) if holds(table, record.channels[0])]
    if len(holding) > 1:
        raise UsageError(f"{record.channels[0]!r} is no one column; there are {listed(tables)}. Name it in full.")
    return holding[0] if holding else 0


def _of_channel(table: RawTable, recipe: Recipe, old: SensorRecord, new: SensorRecord) -> Recalibrated:
    _refuse_other(old, new)
    column = named_column(table, parse_header(old.channels[0])[0], _FROM)
    channel = next((one for one in recipe.channel if one.name == column), None)
    if channel is None or column + SIGMA not in table.names:
        raise UsageError(f"{column!r} was not cleaned: the recipe, or its column of sigma, is without it. {_AGAIN}")
    if (unit := unit_of(table, column) or channel.unit) not in ("", old.unit):
        raise UsageError(f"{column!r} is in {unit}, and --from turns its readings into {old.unit}. {_AGAIN}")
    if channel.switching is not None:
        raise UsageError(f"The filter of {column!r} switches: its signal is not linear in the readings. {_AGAIN}")
    if split := [f"{column}_{part}" for part in channel.parts if f"{column}_{part}" in table.names]:
        raise UsageError(f"The file has parts of {column!r} ({split[0]!r}), which have no zero of their own. {_AGAIN}")
    told = channel.calibration
    tare = _zero_taken(old, told)
    old, new = _with_zero(old, tare), _with_zero(new, tare)
    (slope, zero), (new_slope, new_zero) = _line(old), _line(new)
    factor = new_slope / slope
    return Recalibrated(
        column,
        factor,
        new_zero - factor * zero,
        (0.0, 0.0) if told is None else (told.relative_std, told.offset_std),
        (new.relative_stds[0], new.offset_std),
    )


def _refuse_other(old: SensorRecord, new: SensorRecord) -> None:
    """Refuse a change of calibration that is not one of size and zero alone."""
    named = ", ".join(map(repr, old.channels))
    if len(old.channels) > 1:
        raise UsageError(f"The axes {named} hear of each other, and each was filtered in its own way. {_AGAIN}")
    for one in (old, new):
        conversion = one.conversion
        if isinstance(conversion, Bridge) or (
            isinstance(conversion, CalibrationCurve) and len(conversion.coefficients) != _LINE
        ):
            raise UsageError(f"The sensor of {named} is not linear in its readings. {_AGAIN}")
    if (old.raw_unit, old.unit) != (new.raw_unit, new.unit):
        raise UsageError(
            f"The sensor of {named} turns {old.raw_unit} into {old.unit} by --from, and {new.raw_unit} into {new.unit} "
            "by --to; write both in the same units."
        )
    if new.tare_s not in (None, old.tare_s):
        raise UsageError(f"--to takes the zero of {named} from another stretch than --from. {_AGAIN}")
    if old.full_scale != new.full_scale:
        raise UsageError(f"The sensor of {named} has another full scale, and so other readings are clipped. {_AGAIN}")


def _zero_taken(old: SensorRecord, told: CalibrationRecipe | None) -> Tare | None:
    """Return the zero that was taken when the recording was cleaned, which must be the one that --from asks for."""
    tare = None if told is None or told.tare is None else Tare(**told.tare.model_dump())
    asked = None if old.tare_s is None else (*old.tare_s, old.raw_unit)
    if asked != (None if tare is None else (tare.start_s, tare.stop_s, tare.raw_unit)):
        raise UsageError(
            f"--from and the recipe do not take the same zero of {old.channels[0]!r}: the recording was cleaned with"
            f" another sensor file. {_AGAIN}"
        )
    return tare


def _with_zero(record: SensorRecord, tare: Tare | None) -> SensorRecord:
    return record if record.tare_s is None or tare is None else tared(record, tare)


def _line(record: SensorRecord) -> tuple[float, float]:
    """Return what a linear sensor tells of one reading more, and of a reading of 0."""
    (name,) = record.channels
    zero, one = applied(replace(record, full_scale=None), {name: np.array([0.0, 1.0])})[name]
    return float(one - zero), float(zero)
