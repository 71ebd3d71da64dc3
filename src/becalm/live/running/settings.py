"""Settings of a running stream: commit interval, queue and patience."""

from __future__ import annotations

from dataclasses import dataclass

from becalm.live.running.queueing import Policy


@dataclass(frozen=True)
class Settings:
    """Settings of a running stream.

    Attributes
    ----------
    commit_s : float
        Interval between commits of rows, filters and position, in seconds; with a *short* interval
        fewer rows must be filtered again after a power cut.
    queue_blocks : int
        Largest number of blocks in the queue between reader and filters.
    when_full : {"block", "drop-oldest"}
        Policy for a full queue: the reader waits, or the oldest block is dropped.
    patience_s : float
        Time for which a stop waits for a full disk or an absent server, in seconds.
    """

    commit_s: float = 1.0
    queue_blocks: int = 64
    when_full: Policy = "block"
    patience_s: float = 20.0
