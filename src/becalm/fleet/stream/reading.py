"""What came of one sensor in a micro-batch, as one block of rows in order."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from becalm.core.arrays import Booleans, Floats
from becalm.core.time.live_clock import AGREEING
from becalm.fleet.stream.blocks import Garbled, SensorRows
from becalm.live.address import Address
from becalm.live.block import Block, Loss, LossKind
from becalm.live.messages.stream import MessageStream
from becalm.live.tables import EPOCH_S

_DAY_S = 86400.0  # a clock believes no stamp that is farther ahead


class Entry(NamedTuple):
    """Some rows as they came through the engine, in whichever order it had them."""

    place: int  # which of a sensor's entries it is, where its source keeps an order
    batch: bytes  # `SensorRows`, or a message
    stored_s: float  # when its broker stored it, in seconds since 1970; 0 of rows


def read_rows(entries: Sequence[Entry], channels: Sequence[str], held: Block) -> Block:
    """Return rows of a lake by their stamps, those that waited among them.

    Those with equal stamps are as they were in their block; of several blocks, whose order no engine keeps, always in
    the same order.
    """
    parts = sorted((SensorRows.unpacked(entry.batch) for entry in sorted(entries)), key=_first_stamp)
    waited = _units_under(channels, held)
    units = waited if any(waited) else _most([part for part in parts if any(part.units)])
    kept = [part for part in parts if _alike(part.units, units)]
    units = _known([units, *(part.units for part in kept)])
    time_s = np.concatenate([held.time_s, *(part.time_s for part in kept)])
    values = np.concatenate([_under(channels, held), *(part.values for part in kept)])
    if not (np.diff(time_s) >= 0).all():
        order = np.argsort(time_s, kind="stable")  # rows without a stamp come last
        time_s, values = time_s[order], np.ascontiguousarray(values[order])
    garbled = [one for part in parts for one in part.garbled]
    if others := sum(len(part.time_s) for part in parts) - sum(len(part.time_s) for part in kept):
        garbled.append(Garbled(others, f"{others} rows came in other units than those with them; they were left out."))
    losses = tuple(Loss(LossKind.GARBLED, *one) for one in sorted(garbled, key=str))
    return Block(tuple(channels), units, time_s, values, losses=losses)


def read_messages(
    entries: Sequence[Entry], address: Address, held: Block, state: Mapping[str, Any]
) -> tuple[Block, Mapping[str, Any]]:
    """Return rows of messages as their broker had them, after those that waited; and where their numbers stand."""
    stream = MessageStream(address)
    stream.resume(state)
    stream.take_many([(entry.batch, entry.stored_s) for entry in sorted(entries)])
    block = stream.block()
    return held if block is None else _after(held, block), stream.state


def _first_stamp(part: SensorRows) -> float:
    return float(part.time_s[0]) if len(part.time_s) else -np.inf


def _alike(units: Sequence[str], others: Sequence[str]) -> bool:
    """Whether units are the same, as far as both are told: a file need not have every channel."""
    return all(not one or not other or one == other for one, other in zip(units, others, strict=False))


def _known(told: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """Return the unit of each channel that some of these tell."""
    return tuple(next(filter(None, units), "") for units in zip(*filter(None, told), strict=True))


def _after(held: Block, block: Block) -> Block:
    """Put rows that waited before those that came."""
    if not len(held):
        return block
    if not len(block):
        return replace(held, losses=block.losses)
    if (held.names, held.units) == (block.names, block.units):
        return replace(Block.joined([held, block]), losses=block.losses)
    says = f"The first {len(held)} rows had other channels than those after them; they were left out."
    return replace(block, losses=(Loss(LossKind.GARBLED, len(held), says), *block.losses))


def _most(parts: Sequence[SensorRows]) -> tuple[str, ...]:
    """Return the units that the most rows have."""
    rows = Counter[tuple[str, ...]]()
    for part in parts:
        rows[part.units] += len(part.time_s)
    return max(rows, key=lambda units: (rows[units], units), default=())


def _under(channels: Sequence[str], held: Block) -> Floats:
    """Return readings that waited under the channels that the stream has now, NaN where it had one not."""
    values = np.full((len(held), len(channels)), np.nan)
    for place, name in enumerate(channels):
        if name in held.names:
            values[:, place] = held.values[:, held.names.index(name)]
    return values


def _units_under(channels: Sequence[str], held: Block) -> tuple[str, ...]:
    """Return the units of rows that waited under the channels that the stream has now, "" where none is known."""
    known = dict(zip(held.names, held.units, strict=False))
    return tuple(known.get(name, "") for name in channels)


def stamped(block: Block) -> Block:
    """Leave out rows without a stamp; nothing tells when they were."""
    known = np.isfinite(block.time_s)
    if known.all():
        return block
    count = len(known) - int(np.count_nonzero(known))
    says = f"{count} rows came without a stamp that is a number; they were left out."
    return replace(_some(block, known), losses=(*block.losses, Loss(LossKind.GARBLED, count, says)))


def timely(block: Block, taken_to_s: float, now_s: float) -> Block:
    """Leave out rows of a lake that are stamped before the last that was taken, however many.

    A file that comes late is no clock that was set back, which a live stream believes from eight rows on. That is left
    to the clock where stamps count from a start of their own, or the last that was taken lies in the future.
    """
    late = block.time_s < taken_to_s
    count = int(np.count_nonzero(late))
    if not count or taken_to_s < EPOCH_S or taken_to_s > now_s + _DAY_S:
        return block
    says = f"{count} rows came with stamps before that of a row already taken; they were left out."
    return replace(_some(block, ~late), losses=(*block.losses, Loss(LossKind.LATE, count, says)))


def parted(block: Block, lateness_s: float) -> tuple[Block, Block]:
    """Part rows in order into those to tell now, and those that wait for rows which may come late.

    A row waits until rows came that are stamped `lateness_s` after it, eight of them, so that a wild stamp hurries
    nobody. One that is more than a day ahead of them waits for none, once others are told before it. Nor do rows wait
    whose stamps count from a start of their own: they may begin anew.
    """
    if not lateness_s or not len(block) or not np.fmax.reduce(block.time_s) > EPOCH_S:
        return block, Block.of_losses()
    finite = block.time_s[np.isfinite(block.time_s)]
    newest_s = finite[-min(AGREEING, len(finite))] if len(finite) else np.inf
    waits = block.time_s > newest_s - lateness_s
    if not waits.all():
        waits &= block.time_s <= newest_s + _DAY_S
    return replace(_some(block, ~waits), losses=block.losses), _some(block, waits)


def _some(block: Block, which: Booleans) -> Block:
    if which.all():
        return block
    return Block(block.names, block.units, block.time_s[which], block.values[which])
