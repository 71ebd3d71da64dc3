"""Messages to blocks, for every transport that carries messages: read, put in order, stamped, counted."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

from becalm.core.arrays import Floats
from becalm.live.address import Address
from becalm.live.block import Block, Loss
from becalm.live.lines.columns import LineOptions
from becalm.live.messages.reading import MessageReader, MessageRows
from becalm.live.messages.sequence import Sequence


class MessageStream:
    """Takes the messages of a stream as they come and makes blocks of those that are ready.

    Options of the address: those of lines but `format=` (`columns=`, `channels=`, `time=`, `rate=`).

    Rows without stamps have, with `rate=`, the time that their numbers tell from the first row's arrival on; where
    they have no numbers either, the last row of a message has its arrival's time. Without `rate=`, each message may
    hold one row, of its arrival's time.

    Parameters
    ----------
    address : Address
        With the options.
    reorder : int
        How many messages may wait for one that is behind; 0 of a transport that keeps the order, whose position then
        tells all.

    Attributes
    ----------
    rate_hz : float or None
        Rows a second as the address says; None where it does not.
    """

    OPTIONS = ("columns", "channels", "time", "rate")

    def __init__(self, address: Address, *, reorder: int = 0) -> None:
        options = LineOptions.of(address)
        self.rate_hz = options.rate_hz
        self._reorder = reorder
        self._reader = MessageReader(options)
        self._sequence = Sequence(self._reorder, self.rate_hz or 0.0)
        self._ready: list[MessageRows] = []
        self._arrived_s = 0.0

    @property
    def state(self) -> dict[str, float | int | None]:
        """Where the rows of the last block end, as plain values for JSON."""
        return self._sequence.state

    def resume(self, state: Mapping[str, float | int | None]) -> None:
        """Go on after a state; {} begins."""
        self._sequence = Sequence(self._reorder, self.rate_hz or 0.0)
        self._ready = []
        if state:
            self._sequence.resume(state)

    def take(self, payload: bytes, arrived_s: float) -> None:
        """Hear of a message that came at `arrived_s`, in seconds since 1970."""
        self.take_many([(payload, arrived_s)])

    def take_many(self, messages: list[tuple[bytes, float]]) -> None:
        """Hear of messages, each with its arrival in seconds since 1970: several at once cost less than one by one."""
        now_s = time.monotonic()
        if messages:
            self._arrived_s = now_s - max(0.0, time.time() - messages[-1][1])
        for batch in self._reader.read_many(messages):
            if batch.seq is None:
                self._ready.append(batch)
            else:
                self._sequence.take(batch, now_s)

    def wait_s(self) -> float:
        """Return how long `block` may be put off for the sake of messages that came ahead."""
        return self._sequence.wait_s(time.monotonic())

    def rest(self) -> None:
        """Let go what waits for messages before it: nothing more will come."""
        self._sequence.rest()

    def block(self, *, extra: tuple[Loss, ...] = ()) -> Block | None:
        """Return what is ready; None where that is nothing. The position is left to the source.

        Parameters
        ----------
        extra : tuple of Loss
            What the source itself noticed.
        """
        self._sequence.due(time.monotonic())
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
