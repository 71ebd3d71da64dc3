"""A bounded queue between reader and filters that counts the rows it drops."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import replace
from typing import Literal

import numpy as np

from becalm.live.block import Block, Loss, LossKind

Policy = Literal["block", "drop-oldest"]


class BlockQueue:
    """A bounded queue of blocks that were read and are not filtered yet.

    Parameters
    ----------
    most_blocks : int
        Largest number of blocks; with a *small* number the queue fills soon if the filter is slow.
    policy : {"block", "drop-oldest"}
        While the queue is full, the reader waits ("block"), or the oldest block is dropped and counted.
    """

    def __init__(self, most_blocks: int, policy: Policy) -> None:
        self._most, self._policy = most_blocks, policy
        self._blocks: deque[Block] = deque()
        self._change = threading.Condition()
        self._dropped = 0  # rows
        self._dropped_steps = 0.0  # sum of the dropped blocks' `elapsed`
        self._losses: list[Loss] = []  # carried by the dropped blocks
        self._ended = False
        self._failure: BaseException | None = None

    def put(self, block: Block, stop: threading.Event) -> None:
        """Add a block; with the policy "block" wait for room until `stop` is set."""
        with self._change:
            while len(self._blocks) >= self._most and self._policy == "block" and not stop.is_set():
                self._change.wait(0.1)
            if len(self._blocks) >= self._most and self._policy == "drop-oldest":
                oldest = self._blocks.popleft()
                self._dropped += len(oldest)
                if oldest.elapsed is not None:
                    self._dropped_steps += float(oldest.elapsed.sum())
                self._losses += oldest.losses
            self._blocks.append(block)
            self._change.notify_all()

    def report(self, loss: Loss) -> None:
        """Add a loss after the blocks in the queue, even if the queue is full."""
        with self._change:
            self._blocks.append(Block.of_losses(loss))
            self._change.notify_all()

    def get(self, timeout_s: float, rows: int = 0) -> Block | None:
        """Return the next block, or None after the timeout; its losses include the rows dropped before it.

        Parameters
        ----------
        timeout_s : float
            Longest time to wait, in seconds.
        rows : int
            Queued blocks are joined until the result has at least this many rows, so that a slow filter catches up.
        """
        with self._change:
            if not (self._blocks or self._ended):
                self._change.wait(timeout_s)
            if not self._blocks:
                return None
            block = self._blocks.popleft()
            if self._dropped:
                text = f"Rows arrived faster than they could be filtered; the {self._dropped} oldest were dropped."
                self._losses.append(Loss(LossKind.DROPPED, self._dropped, text))
            if self._losses:
                block = replace(block, losses=(*self._losses, *block.losses))
            self._dropped, self._losses = 0, []
            if self._dropped_steps and block.elapsed is not None:
                block = replace(block, elapsed=np.append(block.elapsed[0] + self._dropped_steps, block.elapsed[1:]))
                self._dropped_steps = 0.0
            joined, count = [block], len(block)
            while self._blocks and count < rows and block.is_joinable_with(self._blocks[0]):
                joined.append(self._blocks.popleft())
                count += len(joined[-1])
            self._change.notify_all()
            return block if len(joined) == 1 else Block.joined(joined)

    def end(self, failure: BaseException | None = None) -> None:
        """Mark the end of the queue; `failure` is the error that ended it, if any."""
        with self._change:
            self._ended, self._failure = True, failure
            self._change.notify_all()

    @property
    def closed(self) -> bool:
        """Return whether the queue has ended, for whatever reason, and is empty."""
        with self._change:
            return self._ended and not self._blocks

    @property
    def ended(self) -> bool:
        """Return whether the queue has ended and is empty; raise the failure that ended it, if any."""
        closed = self.closed
        if closed:
            self.raise_failure()
        return closed

    def raise_failure(self) -> None:
        """Raise the failure that ended the queue, if any."""
        if self._failure is not None:
            raise self._failure

    @property
    def depth(self) -> tuple[int, int]:
        """Return the number of blocks and of rows in the queue."""
        with self._change:
            return len(self._blocks), sum(len(block) for block in self._blocks)
