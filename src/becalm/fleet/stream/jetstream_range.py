"""Read a range of a JetStream stream's messages by sequence numbers; only deleted messages are skipped."""

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

_AT_ONCE, _WAIT_S = 1024, 0.2  # largest number of messages in a list; longest wait for the first message of a list
_AGAIN_S = (1.0, 2.0, 4.0, 8.0, 15.0)  # waits before retries; a server restarts in less than their sum


class StreamRange(NamedTuple):
    """The sequence numbers of the first and the last message that a stream holds."""

    first: int
    last: int
    created: str  # time at which the stream was created, which distinguishes streams of the same name


class SequencedMessage(NamedTuple):
    """A message of a stream."""

    subject: str
    number: int  # sequence number in the stream
    payload: bytes
    stored_s: float  # time at which the server stored it, in seconds since 1970


def found_in(address: Address) -> StreamRange:
    """Return the range of messages that a stream holds now.

    Raises
    ------
    AwayError
        If the server cannot be reached now.
    BecalmError
        If the stream does not exist, or deletes messages after they are read.
    """
    remote = Remote.parsed(address, PORT, PORT)
    name = stream_of(remote)
    with _linked(remote) as link:
        info = link.stream_info(name, reached=True)
    if info.config.retention not in (None, "limits"):
        raise InputError(
            f"The stream {name} deletes messages once they are read (retention {info.config.retention}), so they could "
            "not be read again after a crash; create it anew with --retention limits."
        )
    if "subject" in address.options:
        check_subject(info, address.options["subject"])
    return StreamRange(max(1, info.state.first_seq), info.state.last_seq, str(info.created))


def messages_of(address: Address, first: int, last: int) -> Iterator[list[SequencedMessage]]:
    """Yield the messages with sequence numbers `first` to `last`, in order, as lists.

    Raises
    ------
    AwayError
        If the server cannot be reached for longer than half a minute.
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
                messages, more = pull.take_until(last)
                if messages:
                    yield messages
        finally:
            pull.end()


class _RangePull(NatsPull):
    """A pull that also returns the subjects of messages, and whether more messages follow."""

    def __init__(self, remote: Remote, link: NatsLink) -> None:
        super().__init__(remote, link)
        self._extras: deque[tuple[str, int]] = deque()  # the subject of each message, and how many messages follow it

    def take_until(self, last: int) -> tuple[list[SequencedMessage], bool]:
        """Return the next messages up to sequence number `last`, and whether more may follow."""
        taken = self.take(_WAIT_S, _AT_ONCE)
        if not taken:
            return [], self._is_more()
        extras = [self._extras.popleft() for _ in taken]
        messages = [
            SequencedMessage(subject, message.number, message.payload, message.stored_s)
            for message, (subject, _) in zip(taken, extras, strict=True)
            if message.number <= last
        ]
        return messages, taken[-1].number < last and extras[-1][1] > 0

    def _buffer(self, message: Msg) -> None:
        held = len(self._buffered)
        super()._buffer(message)
        if len(self._buffered) > held:
            self._extras.append(
                (message.subject, int(message.reply.split(".")[8 if message.reply.count(".") == 8 else 10]))
            )

    def _is_more(self) -> bool:
        """Ask the server, and return whether it has messages that are not sent yet, or are still on their way."""
        from nats.errors import Error

        try:
            info = self._link.call(self._link.stream_api.consumer_info(self._stream, self._consumer))
        except (Error, OSError) as cause:
            raise self._remote.away(cause) from cause
        with self._link.changed:
            return bool(info.num_pending > 0 or info.delivered.consumer_seq > self._last or self._buffered)


@contextmanager
def _linked(remote: Remote) -> Iterator[NatsLink]:
    link = NatsLink(remote)
    link.connect(reached=True)
    try:
        yield link
    finally:
        link.close()
