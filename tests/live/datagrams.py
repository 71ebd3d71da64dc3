"""A sender of datagrams on loopback that loses, swaps and doubles what a seed tells."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from becalm.core.arrays import Codes, Floats
from becalm.live.address import Address
from becalm.live.block import Block, Loss
from becalm.live.messages.encoding import Encoder
from becalm.live.sources.udp import UdpSource
from servers import free_port

ROWS = 10
"""Rows in a datagram."""


def message(number: int, form: str = "arrow", rows: int = ROWS, began_s: float = 0.0) -> bytes:
    """Return a datagram whose rows hold their own numbers, stamped 1 ms a row."""
    seq = number * rows
    numbers = np.arange(seq, seq + rows, dtype=np.float64)
    columns: dict[str, Floats | Codes] = {"time": began_s + numbers / 1000, "ax": numbers, "ay": -numbers}
    return Encoder(form).message(columns, seq)


@contextmanager
def wire(options: str = "") -> Iterator[tuple[UdpSource, socket.socket]]:
    """Open a source, and a socket that sends to it."""
    port = free_port()
    source = UdpSource(Address.parsed(f"udp:{port}{options}"))
    source.open("")
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.connect(("127.0.0.1", port))
            yield source, sender
    finally:
        source.close()


def heard(source: UdpSource, enough: int = 0) -> list[Block]:
    """Read until so many rows came, and then until nothing waits."""
    blocks: list[Block] = []
    until = time.monotonic() + 30
    while sum(map(len, blocks)) < enough and time.monotonic() < until:
        block = source.read(0.05)
        blocks += [] if block is None else [block]
    while (block := source.read(0.0)) is not None:
        blocks.append(block)
    return blocks


def rows(blocks: list[Block]) -> Floats:
    """Return the numbers of all rows that were told, once all channels say the same."""
    values = np.concatenate([block.values.reshape(-1, 2) for block in blocks])
    np.testing.assert_array_equal(values[:, 0], -values[:, 1])
    return values[:, 0]


def losses(blocks: list[Block]) -> list[Loss]:
    """Return all that happened."""
    return [loss for block in blocks for loss in block.losses]


def bad_journey(bursts: int, seed: int) -> tuple[list[list[int]], list[int], list[int]]:
    """Return which messages come in each burst of a hundred, which are lost, and which of those that come come twice.

    Of each hundred about one is lost, one changes places with the next of its burst, and one comes twice.
    """
    fate = np.random.default_rng(seed).random(100 * bursts)
    lost = [number for number in range(1, len(fate) - 1) if fate[number] < 0.01]
    doubled = [number for number in range(len(fate)) if fate[number] > 0.99]
    journey = []
    for burst in range(bursts):
        order = [number for number in range(100 * burst, 100 * (burst + 1)) if number not in lost]
        for place in reversed(range(len(order) - 1)):  # from behind, so that none is carried on and on
            if 0.01 <= fate[order[place]] < 0.02:
                order[place], order[place + 1] = order[place + 1], order[place]
        journey.append([number for number in order for _ in range(1 + (number in doubled))])
    return journey, lost, doubled
