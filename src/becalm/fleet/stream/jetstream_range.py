"""A range of a JetStream stream's messages, by their numbers: what is deleted is not there, all else is."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

from becalm.errors import InputError
from becalm.live.address import Address
from becalm.live.brokers.nats_link import PORT, NatsLink, check_subject, stream_of
from becalm.live.brokers.nats_pull import NatsPull
from becalm.live.brokers.remote import Remote
from becalm.live.protocols import AwayError

if TYPE_CHECKING:
    from nats.aio.msg import Msg

_AT_ONCE, _WAIT_S = 1024, 0.2
_AGAIN_S = (1.0, 2.0, 4.0, 8.0, 15.0)  # a server that is started again is back by then


class StreamRange(NamedTuple):
    """Which messages a stream holds."""

    first: int
    last: int
    created: str  # when it was made, which tells it from another of its name


class SequencedMessage(NamedTuple):
    """A message of a stream."""

    subject: str
    number: int
    payload: bytes
    stored_s: float


def found_in(address: Address) -> StreamRange:
    """Return which messages a stream holds now.

    Raises
    ------
    AwayError
        If its server cannot be reached now.
    BecalmError
        If there is no such stream, or none that can be read again.
    """
    remote = Remote.parsed(address, PORT, PORT)
    name = stream_of(remote)
    with _linked(remote) as link:
        info = link.stream_info(name, reached=True)
    if info.config.retention not in (None, "limits"):
        raise InputError(
            f"The stream {name} forgets messages once they are read (retention {info.config.retention}), and nothing "
            "could be read again after a kill; make it anew by --retention limits."
        )
    if "subject" in address.options:
        check_subject(info, address.options["subject"])
    return StreamRange(max(1, info.state.first_seq), info.state.last_seq, str(info.created))


def messages_of(address: Address, first: int, last: int) -> Iterator[list[SequencedMessage]]:
    """Return the messages of a range, in their order, some at a time.

    Raises
    ------
    AwayError
        If the server is away for longer than half a minute.
    """
    again = iter(_AGAIN_S)
    while first <= last:
        try:
            for messages in _read(address, first, last):
                yield messages
                first, again = messages[-1].number + 1, iter(_AGAIN_S)
        except AwayError:
            wait_s = next(again, None)
            if wait_s is None:
                raise
            time.sleep(wait_s)
        else:
            return


def _read(address: Address, first: int, last: int) -> Iterator[list[SequencedMessage]]:
    remote = Remote.parsed(address, PORT, PORT)
    with _linked(remote) as link:
        pull = _RangePull(remote, link)
        pull.begin(stream_of(remote), first, address.options.get("subject"))
        try:
            more = True
            while more:
                came, more = pull.told(last)
                if came:
                    yield came
        finally:
            pull.end()


class _RangePull(NatsPull):
    """Tells the subject of messages too, and how many come after them."""

    def __init__(self, remote: Remote, link: NatsLink) -> None:
        super().__init__(remote, link)
        self._beside: deque[tuple[str, int]] = deque()  # of each message that came

    def told(self, last: int) -> tuple[list[SequencedMessage], bool]:
        """Return the next messages up to a number, and whether there may be more."""
        taken = self.take(_WAIT_S, _AT_ONCE)
        if not taken:
            return [], self._is_more()
        beside = [self._beside.popleft() for _ in taken]
        told = [
            SequencedMessage(subject, message.number, message.payload, message.stored_s)
            for message, (subject, _) in zip(taken, beside, strict=True)
            if message.number <= last
        ]
        return told, taken[-1].number < last and beside[-1][1] > 0

    def _hold(self, told: Msg) -> None:
        held = len(self._came)
        super()._hold(told)
        if len(self._came) > held:
            self._beside.append((told.subject, int(told.reply.split(".")[8 if told.reply.count(".") == 8 else 10])))

    def _is_more(self) -> bool:
        """Ask whether there are messages that the server did not send yet, or that are still on their way."""
        from nats.errors import Error

        try:
            info = self._link.call(self._link.stream_api.consumer_info(self._stream, self._consumer))
        except (Error, OSError) as cause:
            raise self._remote.away(cause) from cause
        with self._link.changed:
            return bool(info.num_pending > 0 or info.delivered.consumer_seq > self._last or self._came)


@contextmanager
def _linked(remote: Remote) -> Iterator[NatsLink]:
    link = NatsLink(remote)
    link.connect(reached=True)
    try:
        yield link
    finally:
        link.close()
