"""How a stream is run."""

from __future__ import annotations

from dataclasses import dataclass

from becalm.live.queueing import Policy


@dataclass(frozen=True)
class Settings:
    """How a stream is run.

    Attributes
    ----------
    commit_s : float
        How often rows, filters and position are kept; with a *short* time a power cut costs less work done again.
    queue_blocks : int
        Blocks that may wait for the filters.
    when_full : {"block", "drop-oldest"}
        What becomes of a block that finds the queue full.
    patience_s : float
        How long a stop waits for a full disk or an absent server.
    """

    commit_s: float = 1.0
    queue_blocks: int = 64
    when_full: Policy = "block"
    patience_s: float = 20.0
