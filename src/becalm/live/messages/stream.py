"""Turn the messages of any transport into blocks: parse, sort and stamp rows, and count losses."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from becalm.core.arrays import Floats
from becalm.live.address import Address
from becalm.live.block import Block, Loss
from becalm.live.lines.columns import LineOptions
from becalm.live.messages.reading import MessageReader, MessageRows
from becalm.live.messages.sequence import Sequence


class MessageStream:
    """A parser of the messages of a stream, which returns their rows as blocks.

    Options of the address: `columns=`, `channels=`, `time=` and `rate=`, as for lines.

    With `rate=`, rows are stamped by their numbers from the arrival of the first row, and stamps of the sender are
    ignored; without numbers, the last row of a message gets the message's arrival time. Without `rate=`, a message
    without stamps may have only one row, which gets the arrival time.

    Parameters
    ----------
    address : Address
        Address with the options.
    reorder : int
        Largest number of messages that wait for a delayed one; 0 for a transport that keeps the order, so that a
        position never has to include waiting messages.
    channels : mapping of str to str, optional
        Names and units of the channels, if they are known and the address names none; by default, the first readable
        message determines them.

    Attributes
    ----------
    rate_hz : float or None
        Sample rate in hertz from the address; None if absent.
    """

    OPTIONS = ("columns", "channels", "time", "rate")

    def __init__(
        self, address: Address, *, reorder: int = 0, channels: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        options = LineOptions.of(address)
        if options.channels:
            channels = {}
        self.rate_hz = options.rate_hz
        self._reorder = reorder
        self._reader = MessageReader(replace(options, channels=options.channels or tuple(channels)), channels.values())
        self._sequence = Sequence(self._reorder, self.rate_hz or 0.0)
        self._ready: list[MessageRows] = []
        self._arrived_s = 0.0

    @property
    def state(self) -> dict[str, float | int | None]:
        """Return the state after the last block as values for JSON."""
        return self._sequence.state

    def resume(self, state: Mapping[str, float | int | None]) -> None:
        """Continue from a state; {} starts a new stream."""
        self._sequence = Sequence(self._reorder, self.rate_hz or 0.0)
        self._ready = []
        if state:
            self._sequence.resume(state)

    def take(self, payload: bytes, arrived_s: float) -> None:
        """Add a message that arrived at `arrived_s`, in seconds since 1970."""
        self.take_many([(payload, arrived_s)])

    def take_many(self, messages: list[tuple[bytes, float]]) -> None:
        """Add messages with their arrival times in seconds since 1970; this is faster than adding them one by one."""
        now_s = time.monotonic()
        if messages:
            self._arrived_s = now_s - max(0.0, time.time() - messages[-1][1])
        for batch in self._reader.read_many(messages):
            if batch.seq is None:
                self._ready.append(batch)
            else:
                self._sequence.take(batch, now_s)

    def wait_s(self) -> float:
        """Return the time until `block` must be called because of waiting messages, in seconds."""
        return self._sequence.wait_s(time.monotonic())

    def release_all(self) -> None:
        """Release the messages that wait for earlier ones."""
        self._sequence.release_all()

    def block(self, *, extra: tuple[Loss, ...] = ()) -> Block | None:
        """Return the rows that are ready and the losses; None if there are none. The source adds the position.

        Parameters
        ----------
        extra : tuple of Loss
            Losses that the source itself has found.
        """
        self._sequence.release_due(time.monotonic())
        batches = self._ready + self._sequence.ready()
        self._ready = []
        losses = (*extra, *self._reader.losses(), *self._sequence.losses())
        if not batches and not losses:
            return None
        names, units = self._reader.names, self._reader.units
        values = [batch.values for batch in batches] or [np.empty((0, len(names)))]
        stamps = [self._stamps(batch) for batch in batches] or [np.empty(0)]
        return Block(
            names,
            units,
            np.concatenate(stamps),
            np.concatenate(values),
            losses=losses,
            arrived_s=self._arrived_s,
        )

    def _stamps(self, batch: MessageRows) -> Floats:
        if batch.time_s is not None:
            return batch.time_s
        back = np.arange(1 - len(batch), 1) / (self.rate_hz or 1.0)
        return batch.arrived_s + back
