"""Count what a stream has done so far; status file and metrics read these counts."""

from __future__ import annotations

import hashlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np

from becalm.core.arrays import Floats, Integers
from becalm.core.reading_verdicts import Verdict
from becalm.installation import version
from becalm.live.block import Block, Loss, LossKind, Output
from becalm.live.watching.memory import resident_bytes

State = Literal["starting", "learning", "running", "away", "silent", "full", "stopping", "ended", "failed"]
"""State of a stream."""

LATENCIES = 4096
"""Number of last outputs from which the latency percentiles are computed."""

RATE_OVER_S = 10
"""Time over which the rate is averaged, in seconds."""

_WORDS = tuple(verdict.name.lower() for verdict in Verdict)


@dataclass
class Losses:
    """Counts of the losses of one kind.

    Attributes
    ----------
    events, rows : int
        Number of losses, and number of affected rows where it is known.
    says : str
        Sentence of the last loss.
    noticed_s : float
        Time of the last loss, in seconds since 1970.
    """

    events: int = 0
    rows: int = 0
    says: str = ""
    noticed_s: float = 0.0


@dataclass
class _Commits:
    count: int = 0
    rows: int = 0
    took_s: float = 0.0
    longest_s: float = 0.0
    last_s: float | None = None  # time of the last commit, on the meter's clock
    position: str = ""


@dataclass
class _Latencies:
    """A ring buffer of the last latencies in seconds, and the count, sum and maximum of all latencies."""

    ring: Floats = field(default_factory=lambda: np.zeros(LATENCIES))
    count: int = 0
    total_s: float = 0.0
    longest_s: float = 0.0

    def add(self, latency_s: float) -> None:
        self.ring[self.count % LATENCIES] = latency_s
        self.count += 1
        self.total_s += latency_s
        self.longest_s = max(self.longest_s, latency_s)

    def status(self, last: Floats) -> dict[str, Any]:
        """Return the latencies in milliseconds; the percentiles are computed from the latencies `last`, in seconds."""
        middle, late = (float(each) for each in np.percentile(last, [50, 99])) if len(last) else (None, None)
        return {
            "p50": _milli(middle),
            "p99": _milli(late),
            "max": _milli(float(last.max()) if len(last) else None),
            "longest_ever": _milli(self.longest_s),
            "sum": _milli(self.total_s),
            "outputs": self.count,
        }


class Meter:
    """Counts of one stream; any thread may call the methods, which take a few microseconds each.

    Parameters
    ----------
    source : str
        The source's address without secrets.
    clock : callable
        Function that returns the time in seconds, the clock of `Output.arrived_s`; by default `time.monotonic`.
    """

    def __init__(self, source: str = "", *, clock: Callable[[], float] = time.monotonic) -> None:
        self._lock, self._clock = threading.Lock(), clock
        self._started_s, self._begun_s = time.time(), clock()
        self._state: State = "starting"
        self._says, self._since_s = "", self._started_s
        self._loop_s = self._begun_s
        self._rows_taken = self._rows = 0
        self._queue = (0, 0)
        self._seconds: deque[tuple[int, int]] = deque(maxlen=RATE_OVER_S + 1)  # (whole second on the clock, rows in it)
        self._latencies, self._commits = _Latencies(), _Commits()
        self._losses = {kind: Losses() for kind in LossKind}
        self._all_used = np.eye(1, len(Verdict), Verdict.USED, np.int64)  # counts of one used reading
        self._health: dict[str, tuple[float, tuple[str, ...]]] = {}
        self._source = source
        self.recipe = ""
        """Current recipe as TOML; "" before the first."""
        self.begin((), "")

    def begin(self, names: Sequence[str], recipe: str) -> None:
        """Set the channels of all following outputs, and the recipe (TOML)."""
        with self._lock:
            self._names = tuple(names)
            self._verdicts = np.zeros((len(self._names), len(Verdict)), np.int64)
            self._first_codes = np.arange(len(self._names)) * len(Verdict)  # index of each channel's first count
        self.set_recipe(recipe)

    def set_recipe(self, recipe: str) -> None:
        """Set the recipe (TOML) of all following rows."""
        self.recipe = recipe
        self._sha256 = hashlib.sha256(recipe.encode()).hexdigest() if recipe else ""

    def count_block(self, block: Block) -> None:
        """Count a block from the source."""
        with self._lock:
            self._rows_taken += len(block)

    def set_queue(self, blocks: int, rows: int) -> None:
        """Set the number of blocks and rows in the queue before the filter."""
        self._queue = (blocks, rows)

    def record_iteration(self) -> None:
        """Record an iteration of the main loop."""
        self._loop_s = self._clock()

    def record(self, output: Output) -> None:
        """Count rows that were passed to the sinks, and their losses."""
        now_s = self._clock()
        counts = self._verdict_counts(output)
        with self._lock:
            self._count(output.losses)
            if not len(output):
                return
            self._rows += len(output)
            self._verdicts += counts
            if output.arrived_s:  # 0 at the end of the stream, when rows with several arrival times are returned
                self._latencies.add(now_s - output.arrived_s)
            second = int(now_s)
            if self._seconds and self._seconds[-1][0] == second:
                self._seconds[-1] = (second, self._seconds[-1][1] + len(output))
            else:
                self._seconds.append((second, len(output)))

    def count_losses(self, losses: Iterable[Loss]) -> None:
        """Count losses that no output carries, because the stream has no rows yet."""
        with self._lock:
            self._count(losses)

    def count_commit(self, rows: int, took_s: float, position: str = "") -> None:
        """Count a commit: its rows, its duration in seconds, and the position from which a restart continues."""
        with self._lock:
            commits = self._commits
            commits.count += 1
            commits.rows += rows
            commits.took_s, commits.longest_s = took_s, max(commits.longest_s, took_s)
            commits.last_s, commits.position = self._clock(), position

    def health(self, channel: str, nis: float, alarms: Sequence[str] = ()) -> None:
        """Set a channel's alarms, and its normalised innovation squared (1 if the model is right, NaN if unknown)."""
        with self._lock:
            self._health[channel] = (nis, tuple(alarms))

    def state(self, state: State, says: str = "") -> None:
        """Set the state of the stream; the time of the last change is recorded."""
        with self._lock:
            if state != self._state:
                self._since_s = time.time()
            self._state, self._says = state, says

    def status(self) -> dict[str, Any]:
        """Return all counts as values for JSON: times in UTC, latencies in milliseconds, ages in seconds."""
        now_s = self._clock()
        with self._lock:
            last = self._latencies.ring[: min(self._latencies.count, LATENCIES)].copy()
            status: dict[str, Any] = {
                "version": version(),
                "written": _utc(time.time()),
                "state": self._state,
                "says": self._says,
                "since": _utc(self._since_s),
                "started": _utc(self._started_s),
                "loop_age_s": round(now_s - self._loop_s, 3),
                "source": self._source,
                "recipe_sha256": self._sha256,
                "rows_taken": self._rows_taken,
                "rows": self._rows,
                "rows_per_s": round(self._rate(now_s), 3),
                "queue": dict(zip(("blocks", "rows"), self._queue, strict=True)),
                "commits": self._commit_status(now_s),
                "losses": {kind.value: _loss_status(losses) for kind, losses in self._losses.items()},
                "channels": self._channel_status(),
                "memory_bytes": resident_bytes(),
                "position": self._commits.position,
            }
        return status | {"latency_ms": self._latencies.status(last)}

    def _verdict_counts(self, output: Output) -> Integers:
        """Return the counts of verdicts, (m, kinds), or (1, kinds) for every channel if all readings were used."""
        if not output.verdicts.any():
            return len(output) * self._all_used
        codes = (output.verdicts + self._first_codes).ravel()
        return np.bincount(codes, minlength=self._verdicts.size).reshape(self._verdicts.shape)

    def _count(self, losses: Iterable[Loss]) -> None:
        for loss in losses:
            losses_of_kind = self._losses[loss.kind]
            losses_of_kind.events += 1
            losses_of_kind.rows += loss.rows or 0
            losses_of_kind.says, losses_of_kind.noticed_s = loss.says, loss.noticed_s

    def _rate(self, now_s: float) -> float:
        """Return the rows per second over the last full seconds, at most RATE_OVER_S."""
        now = int(now_s)
        past = min(RATE_OVER_S, now - int(self._begun_s))
        rows = sum(rows for second, rows in self._seconds if now - past <= second < now)
        return rows / past if past else 0.0

    def _commit_status(self, now_s: float) -> dict[str, Any]:
        commits = self._commits
        return {
            "count": commits.count,
            "rows": commits.rows,
            "last_age_s": None if commits.last_s is None else round(now_s - commits.last_s, 3),
            "last_took_ms": _milli(commits.took_s),
            "longest_took_ms": _milli(commits.longest_s),
        }

    def _channel_status(self) -> dict[str, Any]:
        channels = {}
        for name, counts in zip(self._names, self._verdicts.tolist(), strict=True):
            nis, alarms = self._health.get(name, (math.nan, ()))
            verdicts = {word: count for word, count in zip(_WORDS, counts, strict=True) if count}
            channels[name] = {"verdicts": verdicts, "nis": nis if math.isfinite(nis) else None, "alarms": list(alarms)}
        return channels


def _loss_status(losses: Losses) -> dict[str, Any]:
    at = _utc(losses.noticed_s) if losses.events else None
    return {"events": losses.events, "rows": losses.rows, "says": losses.says, "at": at}


def _milli(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds * 1e3, 4)


def _utc(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
