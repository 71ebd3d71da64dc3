"""Join the rows of one sensor in a micro-batch into one sorted block; drop late rows and rows without a stamp."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from becalm.cleaning.recipes.recipe import Recipe
from becalm.core.arrays import Booleans, Floats
from becalm.core.time.live_clock import AGREEING
from becalm.fleet.stream.blocks import SensorRows, UnreadableInput
from becalm.live.address import Address
from becalm.live.block import Block, Loss, LossKind
from becalm.live.messages.stream import MessageStream
from becalm.live.tables import EPOCH_S

_DAY_S = 86400.0  # a stamp farther in the future than this counts as wrong


class Entry(NamedTuple):
    """Packed rows, or a message, of one sensor. Spark delivers them in any order."""

    place: int  # position among the sensor's messages; 0 for rows of files
    batch: bytes  # packed `SensorRows`, or a message
    stored_s: float  # time at which the broker stored the message, in seconds since 1970; 0 for rows of files


def read_rows(entries: Sequence[Entry], channels: Sequence[str], held: Block) -> Block:
    """Return the new rows of a lake together with the waiting rows (`held`), sorted by stamp.

    Rows with equal stamps keep the order of their block. Spark delivers blocks in any order; they are sorted before the
    rows, so that the result does not depend on this order.
    """
    parts = sorted((SensorRows.unpacked(entry.batch) for entry in sorted(entries)), key=_first_stamp)
    waited = _units_of_channels(channels, held)
    units = waited if any(waited) else _most_frequent_units([part for part in parts if any(part.units)])
    kept = [part for part in parts if _units_agree(part.units, units)]
    units = _merged_units([units, *(part.units for part in kept)])
    time_s = np.concatenate([held.time_s, *(part.time_s for part in kept)])
    values = np.concatenate([_values_of_channels(channels, held), *(part.values for part in kept)])
    if not (np.diff(time_s) >= 0).all():
        order = np.argsort(time_s, kind="stable")  # rows without a stamp come last
        time_s, values = time_s[order], np.ascontiguousarray(values[order])
    garbled = [one for part in parts for one in part.garbled]
    if others := sum(len(part.time_s) for part in parts) - sum(len(part.time_s) for part in kept):
        garbled.append(
            UnreadableInput(
                others, f"{others} rows had other units than the rest of their micro-batch; they were left out."
            )
        )
    losses = tuple(Loss(LossKind.GARBLED, *one) for one in sorted(garbled, key=str))
    return Block(tuple(channels), units, time_s, values, losses=losses)


def read_messages(
    entries: Sequence[Entry], address: Address, held: Block, state: Mapping[str, Any], recipe: Recipe | None
) -> tuple[Block, Mapping[str, Any]]:
    """Return the waiting rows, then those of messages in the broker's order; and the new state of the numbering.

    The recipe, if there is one, says which channels messages have. Otherwise the first message of a micro-batch would,
    and the result would depend on where it begins.
    """
    channels = {} if recipe is None else {channel.name: channel.unit for channel in recipe.channel}
    stream = MessageStream(address, channels=channels)
    stream.resume(state)
    stream.take_many([(entry.batch, entry.stored_s) for entry in sorted(entries)])
    block = stream.block()
    return held if block is None else _append_rows(held, block), stream.state


def _first_stamp(part: SensorRows) -> float:
    return float(part.time_s[0]) if len(part.time_s) else -np.inf


def _units_agree(units: Sequence[str], others: Sequence[str]) -> bool:
    """Return whether units are equal where both are known; they are unknown for channels that a file lacks."""
    return all(not one or not other or one == other for one, other in zip(units, others, strict=False))


def _merged_units(parts: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Return the first known unit of each channel."""
    return tuple(next(filter(None, units), "") for units in zip(*filter(None, parts), strict=True))


def _append_rows(held: Block, block: Block) -> Block:
    """Return the waiting rows followed by the new rows."""
    if not len(held):
        return block
    if not len(block):
        return replace(held, losses=block.losses)
    if (held.names, held.units) == (block.names, block.units):
        return replace(Block.joined([held, block]), losses=block.losses)
    says = f"The first {len(held)} rows had other channels than those after them; they were left out."
    return replace(block, losses=(Loss(LossKind.GARBLED, len(held), says), *block.losses))


def _most_frequent_units(parts: Sequence[SensorRows]) -> tuple[str, ...]:
    """Return the units that most rows have; () if there are no parts."""
    rows = Counter[tuple[str, ...]]()
    for part in parts:
        rows[part.units] += len(part.time_s)
    return max(rows, key=lambda units: (rows[units], units), default=())


def _values_of_channels(channels: Sequence[str], held: Block) -> Floats:
    """Return the readings of waiting rows, in the order of the stream's channels; NaN for a channel they lack."""
    values = np.full((len(held), len(channels)), np.nan)
    for place, name in enumerate(channels):
        if name in held.names:
            values[:, place] = held.values[:, held.names.index(name)]
    return values


def _units_of_channels(channels: Sequence[str], held: Block) -> tuple[str, ...]:
    """Return the units of waiting rows, in the order of the stream's channels; "" if unknown."""
    units = dict(zip(held.names, held.units, strict=False))
    return tuple(units.get(name, "") for name in channels)


def drop_unstamped(block: Block) -> Block:
    """Drop rows without a finite stamp, because their time is unknown."""
    finite = np.isfinite(block.time_s)
    if finite.all():
        return block
    count = len(finite) - int(np.count_nonzero(finite))
    says = f"{count} rows came without a stamp that is a number; they were left out."
    return replace(_select_rows(block, finite), losses=(*block.losses, Loss(LossKind.GARBLED, count, says)))


def drop_late(block: Block, last_stamp_s: float, now_s: float) -> Block:
    """Drop the rows of a lake whose stamps are before `last_stamp_s`, the stamp of the last filtered row.

    In a live stream, eight such rows mean that the clock was set back. In a lake, they come from a late file. If stamps
    do not count from 1970, or if `last_stamp_s` is more than a day after `now_s`, the rule of live streams applies, and
    this function drops nothing.
    """
    late = block.time_s < last_stamp_s
    count = int(np.count_nonzero(late))
    if not count or last_stamp_s < EPOCH_S or last_stamp_s > now_s + _DAY_S:
        return block
    says = f"{count} rows came with stamps before that of a row already taken; they were left out."
    return replace(_select_rows(block, ~late), losses=(*block.losses, Loss(LossKind.LATE, count, says)))


def split_by_lateness(block: Block, lateness_s: float) -> tuple[Block, Block]:
    """Split sorted rows into rows to filter now, and rows that wait because earlier rows may still arrive.

    A row waits until eight rows have stamps at least `lateness_s` after its own; with eight, a single wrong stamp does
    not end the wait. A row whose stamp is more than a day after that of the eighth newest row does not wait if other
    rows are ready. Rows whose stamps do not count from 1970 do not wait, because their clock may restart.
    """
    if not lateness_s or not len(block) or not np.fmax.reduce(block.time_s) > EPOCH_S:
        return block, Block.of_losses()
    finite = block.time_s[np.isfinite(block.time_s)]
    newest_s = finite[-min(AGREEING, len(finite))] if len(finite) else np.inf
    waits = block.time_s > newest_s - lateness_s
    if not waits.all():
        waits &= block.time_s <= newest_s + _DAY_S
    return replace(_select_rows(block, ~waits), losses=block.losses), _select_rows(block, waits)


def _select_rows(block: Block, which: Booleans) -> Block:
    if which.all():
        return block
    return Block(block.names, block.units, block.time_s[which], block.values[which])
