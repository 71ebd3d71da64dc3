"""Outboxes: whatever is gathered, cut, sent, acknowledged and sent again, each row is told once and in order."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from becalm.errors import OutputError
from becalm.live.address import Address
from becalm.live.lines.columns import LineOptions
from becalm.live.messages.reading import MessageReader
from becalm.live.sinks.outbox import Outbox, OutgoingMessage
from brokered import HEAD, output


def numbers(letters: list[OutgoingMessage]) -> list[int]:
    """Return the rows that messages hold."""
    reader = MessageReader(LineOptions.of(Address.parsed("mqtt:?channels=ax,ay")))
    batches = [reader.read(letter.payload, 0.0) for letter in letters]
    assert all(batch is not None and batch.seq == batch.values[0, 0] for batch in batches)
    return [int(number) for batch in batches if batch is not None for number in batch.values[:, 0]]


@given(
    st.lists(st.integers(0, 40), max_size=12),
    st.sampled_from([0.0, 1000.0]),
    st.sampled_from([2_500, 250_000]),
    st.sampled_from(["arrow", "json"]),
    st.data(),
)
def test_each_row_is_told_once_and_in_order(
    sizes: list[int], gather_s: float, largest: int, form: str, data: st.DataObject
) -> None:
    outbox, told, row, number = Outbox(form, gather_s), [], 0, 0
    outbox.begin(HEAD)
    flying: list[tuple[int, OutgoingMessage]] = []
    for size in sizes:
        outbox.put(output(row, size), largest)
        row += size
        while (letter := outbox.next()) is not None and data.draw(st.booleans()):
            assert len(letter.payload) <= largest
            outbox.sent(number := number + 1)
            flying.append((number, letter))
        kept = data.draw(st.integers(0, len(flying)))
        told += [letter for _, letter in flying[:kept]]
        outbox.drop_acknowledged({place for place, _ in flying[:kept]})
        flying = flying[kept:]
        if data.draw(st.booleans()):
            outbox.begin(HEAD)  # the connection ended
            if flying:  # some of it had come all the same
                came = data.draw(st.integers(0, len(flying)))
                told += [letter for _, letter in flying[:came]]
                outbox.drop_through(flying[came - 1][1].name if came else "another's")
            flying = []
    told += [letter for _, letter in flying]
    outbox.seal(largest)
    while (letter := outbox.next()) is not None:
        outbox.sent(number := number + 1)
        told.append(letter)
    assert numbers(told) == list(range(row))


def test_outputs_are_gathered_into_one_message() -> None:
    outbox = Outbox("arrow", 1000.0)
    outbox.begin(HEAD)
    for row in range(0, 50, 5):
        outbox.put(output(row, 5), 250_000)
    assert outbox.next() is None
    outbox.seal(250_000)
    letter = outbox.next()
    assert letter is not None
    assert numbers([letter]) == list(range(50))
    assert len(outbox) == 1


def test_rows_that_do_not_follow_are_not_gathered() -> None:
    outbox = Outbox("arrow", 1000.0)
    outbox.begin(HEAD)
    outbox.put(output(0, 5), 250_000)
    outbox.put(output(0, 5), 250_000)  # a stream that was told again
    outbox.seal(250_000)
    assert len(outbox) == 2


def test_many_rows_are_not_gathered_for_long() -> None:
    outbox = Outbox("arrow", 1000.0)
    outbox.begin(HEAD)
    for row in range(0, 20_000, 1000):
        outbox.put(output(row, 1000), 250_000)
    assert outbox.next() is not None


def test_a_row_that_is_larger_than_any_message_is_refused() -> None:
    outbox = Outbox("arrow", 0.0)
    outbox.begin(HEAD)
    with pytest.raises(OutputError, match="A row of 2 channels"):
        outbox.put(output(0, 5), 100)
