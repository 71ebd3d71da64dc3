"""Between the wire and the filters: a queue that is bounded, and counts what it had to drop."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import replace
from typing import Literal

import numpy as np

from becalm.live.block import Block, Loss, LossKind

Policy = Literal["block", "drop-oldest"]


class BlockQueue:
    """Blocks that were read and not filtered yet.

    Parameters
    ----------
    most_blocks : int
        How many may wait; with a *small* number a slow filter is felt at once.
    policy : {"block", "drop-oldest"}
        Of a full queue: the reader waits, or the oldest block is dropped, and counted.
    """

    def __init__(self, most_blocks: int, policy: Policy) -> None:
        self._most, self._policy = most_blocks, policy
        self._blocks: deque[Block] = deque()
        self._change = threading.Condition()
        self._dropped = 0  # rows
        self._passed = 0.0  # steps over which they went, where they tell
        self._losses: list[Loss] = []  # of blocks that were dropped
        self._ended = False
        self._failure: BaseException | None = None

    def put(self, block: Block, stop: threading.Event) -> None:
        """Add a block; wait for room where the policy says so, and no one stops."""
        with self._change:
            while len(self._blocks) >= self._most and self._policy == "block" and not stop.is_set():
                self._change.wait(0.1)
            if len(self._blocks) >= self._most and self._policy == "drop-oldest":
                oldest = self._blocks.popleft()
                self._dropped += len(oldest)
                if oldest.elapsed is not None:
                    self._passed += float(oldest.elapsed.sum())
                self._losses += oldest.losses
            self._blocks.append(block)
            self._change.notify_all()

    def tell(self, loss: Loss) -> None:
        """Add what happened to the stream, in its place between the blocks."""
        with self._change:
            self._blocks.append(Block.of_losses(loss))
            self._change.notify_all()

    def get(self, timeout_s: float, rows: int = 0) -> Block | None:
        """Return the next block, or None where none comes in time; what was dropped before it is told with it.

        Parameters
        ----------
        timeout_s : float
            How long to wait.
        rows : int
            Blocks that wait behind it come with it, joined, until there are so many rows: whoever is late catches up.
        """
        with self._change:
            if not (self._blocks or self._ended):
                self._change.wait(timeout_s)
            if not self._blocks:
                return None
            block = self._blocks.popleft()
            if self._dropped:
                says = f"{self._dropped} rows came faster than they could be filtered; the oldest were dropped."
                lost = Loss(LossKind.DROPPED, self._dropped, says)
                block = replace(block, losses=(*self._losses, lost, *block.losses))
                self._dropped, self._losses = 0, []
            if self._passed and block.elapsed is not None:
                block = replace(block, elapsed=np.append(block.elapsed[0] + self._passed, block.elapsed[1:]))
                self._passed = 0.0
            joined, count = [block], len(block)
            while self._blocks and count < rows and block.goes_on_in(self._blocks[0]):
                joined.append(self._blocks.popleft())
                count += len(joined[-1])
            self._change.notify_all()
            return block if len(joined) == 1 else Block.joined(joined)

    def end(self, failure: BaseException | None = None) -> None:
        """Hear that no more will come, and why if that is wrong."""
        with self._change:
            self._ended, self._failure = True, failure
            self._change.notify_all()

    @property
    def closed(self) -> bool:
        """Whether no more will come, for whatever reason, and all that was read is taken."""
        with self._change:
            return self._ended and not self._blocks

    @property
    def ended(self) -> bool:
        """Whether no more will come; a failure is raised once all that was read is taken."""
        closed = self.closed
        if closed:
            self.raise_failure()
        return closed

    def raise_failure(self) -> None:
        """Raise why no more comes, if that is wrong."""
        if self._failure is not None:
            raise self._failure

    @property
    def depth(self) -> tuple[int, int]:
        """Blocks and rows that wait."""
        with self._change:
            return len(self._blocks), sum(len(block) for block in self._blocks)
