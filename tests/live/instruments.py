"""What tests of instruments share."""

from __future__ import annotations

from becalm.live.block import Block
from becalm.live.protocols import Source


def next_block(source: Source) -> Block:
    """Return the next block, which has to come."""
    block = source.read(30.0)
    assert block is not None
    return block
