"""What a stream has done so far, counted as it goes by: the one place that status, metrics and logs read."""

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
from becalm.core.verdict import Verdict
from becalm.installation import version
from becalm.live.block import Block, Loss, LossKind, Output
from becalm.live.watching.memory import resident_bytes

State = Literal["starting", "learning", "running", "away", "silent", "full", "stopping", "ended", "failed"]
"""What a stream may be doing."""

LATENCIES = 4096
"""How many of the last outputs tell the percentiles of latency."""

RATE_OVER_S = 10
"""Over how many seconds the rate is told."""

_WORDS = tuple(verdict.name.lower() for verdict in Verdict)


@dataclass
class Losses:
    """What was lost in one way.

    Attributes
    ----------
    events, rows : int
        How often, and how many rows, where that is known.
    says : str
        The last one, in a sentence.
    noticed_s : float
        When that was, in seconds since 1970.
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
    last_s: float | None = None  # by the meter's clock
    position: str = ""


@dataclass
class _Latencies:
    """The last of them in a ring, and the sum of all."""

    ring: Floats = field(default_factory=lambda: np.zeros(LATENCIES))
    count: int = 0
    total_s: float = 0.0
    longest_s: float = 0.0

    def add(self, latency_s: float) -> None:
        self.ring[self.count % LATENCIES] = latency_s
        self.count += 1
        self.total_s += latency_s
        self.longest_s = max(self.longest_s, latency_s)

    def told(self, last: Floats) -> dict[str, Any]:
        """Describe them in milliseconds, the percentiles of `last`."""
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
    """Counts of one stream; every call takes a few microseconds, and may come from any thread.

    Parameters
    ----------
    source : str
        The source's address without secrets.
    clock : callable
        `time.monotonic`, as in `Output.arrived_s`.
    """

    def __init__(self, source: str = "", *, clock: Callable[[], float] = time.monotonic) -> None:
        self._lock, self._clock = threading.Lock(), clock
        self._started_s, self._begun_s = time.time(), clock()
        self._state: State = "starting"
        self._says, self._since_s = "", self._started_s
        self._turned_s = self._begun_s
        self._taken = self._told = 0
        self._queue = (0, 0)
        self._seconds: deque[tuple[int, int]] = deque(maxlen=RATE_OVER_S + 1)  # whole seconds, and rows told in each
        self._latencies, self._commits = _Latencies(), _Commits()
        self._losses = {kind: Losses() for kind in LossKind}
        self._all_used = np.eye(1, len(Verdict), Verdict.USED, np.int64)
        self._health: dict[str, tuple[float, tuple[str, ...]]] = {}
        self._source = source
        self.recipe = ""
        """Through which recipe (TOML) rows go; "" before the first."""
        self.begin((), "")

    def begin(self, names: Sequence[str], recipe: str) -> None:
        """Say which channels every `Output` has from now on, and through which recipe (TOML) they go."""
        with self._lock:
            self._names = tuple(names)
            self._verdicts = np.zeros((len(self._names), len(Verdict)), np.int64)
            self._first_codes = np.arange(len(self._names)) * len(Verdict)  # each channel's in one row of counts
        self.tuned(recipe)

    def tuned(self, recipe: str) -> None:
        """Say through which recipe (TOML) rows go from now on."""
        self.recipe = recipe
        self._sha256 = hashlib.sha256(recipe.encode()).hexdigest() if recipe else ""

    def took(self, block: Block) -> None:
        """Count a block that came from the source."""
        with self._lock:
            self._taken += len(block)

    def queued(self, blocks: int, rows: int) -> None:
        """Say how much waits between source and filter now."""
        self._queue = (blocks, rows)

    def turned(self) -> None:
        """Say that the main loop has come round once more."""
        self._turned_s = self._clock()

    def told(self, output: Output) -> None:
        """Count rows that sinks have got, and what is told with them of losses."""
        now_s = self._clock()
        counts = self._counted(output)
        with self._lock:
            self._count(output.losses)
            if not len(output):
                return
            self._told += len(output)
            self._verdicts += counts
            self._latencies.add(now_s - output.arrived_s)
            second = int(now_s)
            if self._seconds and self._seconds[-1][0] == second:
                self._seconds[-1] = (second, self._seconds[-1][1] + len(output))
            else:
                self._seconds.append((second, len(output)))

    def lost(self, losses: Iterable[Loss]) -> None:
        """Count what happened to a stream that has no rows yet."""
        with self._lock:
            self._count(losses)

    def kept(self, rows: int, took_s: float, position: str = "") -> None:
        """Count a commit: its rows, how long it took in seconds, and where a restart would go on."""
        with self._lock:
            done = self._commits
            done.count += 1
            done.rows += rows
            done.took_s, done.longest_s = took_s, max(done.longest_s, took_s)
            done.last_s, done.position = self._clock(), position

    def health(self, channel: str, nis: float, alarms: Sequence[str] = ()) -> None:
        """Say how a channel's filter fares: its windowed NIS (1 is right, NaN unknown), and what is wrong."""
        with self._lock:
            self._health[channel] = (nis, tuple(alarms))

    def state(self, state: State, says: str = "") -> None:
        """Say what the stream is doing; the time is that of the last change of state."""
        with self._lock:
            if state != self._state:
                self._since_s = time.time()
            self._state, self._says = state, says

    def status(self) -> dict[str, Any]:
        """Return all counts as plain values, ready for JSON: times in UTC, latencies in ms, ages in seconds."""
        now_s = self._clock()
        with self._lock:
            last = self._latencies.ring[: min(self._latencies.count, LATENCIES)].copy()
            told: dict[str, Any] = {
                "version": version(),
                "written": _utc(time.time()),
                "state": self._state,
                "says": self._says,
                "since": _utc(self._since_s),
                "started": _utc(self._started_s),
                "loop_age_s": round(now_s - self._turned_s, 3),
                "source": self._source,
                "recipe_sha256": self._sha256,
                "rows_taken": self._taken,
                "rows": self._told,
                "rows_per_s": round(self._rate(now_s), 3),
                "queue": dict(zip(("blocks", "rows"), self._queue, strict=True)),
                "commits": self._committed(now_s),
                "losses": {kind.value: _told_of(losses) for kind, losses in self._losses.items()},
                "channels": self._channels(),
                "memory_bytes": resident_bytes(),
                "position": self._commits.position,
            }
        return told | {"latency_ms": self._latencies.told(last)}

    def _counted(self, output: Output) -> Integers:
        """Count each channel's verdicts, (m, kinds): at once where all readings were used, as they mostly are."""
        if not output.verdicts.any():
            return len(output) * self._all_used
        codes = (output.verdicts + self._first_codes).ravel()
        return np.bincount(codes, minlength=self._verdicts.size).reshape(self._verdicts.shape)

    def _count(self, losses: Iterable[Loss]) -> None:
        for loss in losses:
            sort = self._losses[loss.kind]
            sort.events += 1
            sort.rows += loss.rows or 0
            sort.says, sort.noticed_s = loss.says, loss.noticed_s

    def _rate(self, now_s: float) -> float:
        """Return rows a second over the whole seconds before this one, as many as there were."""
        now = int(now_s)
        past = min(RATE_OVER_S, now - int(self._begun_s))
        rows = sum(rows for second, rows in self._seconds if now - past <= second < now)
        return rows / past if past else 0.0

    def _committed(self, now_s: float) -> dict[str, Any]:
        done = self._commits
        return {
            "count": done.count,
            "rows": done.rows,
            "last_age_s": None if done.last_s is None else round(now_s - done.last_s, 3),
            "last_took_ms": _milli(done.took_s),
            "longest_took_ms": _milli(done.longest_s),
        }

    def _channels(self) -> dict[str, Any]:
        told = {}
        for name, counts in zip(self._names, self._verdicts.tolist(), strict=True):
            nis, alarms = self._health.get(name, (math.nan, ()))
            met = {word: count for word, count in zip(_WORDS, counts, strict=True) if count}
            told[name] = {"verdicts": met, "nis": nis if math.isfinite(nis) else None, "alarms": list(alarms)}
        return told


def _told_of(losses: Losses) -> dict[str, Any]:
    at = _utc(losses.noticed_s) if losses.events else None
    return {"events": losses.events, "rows": losses.rows, "says": losses.says, "at": at}


def _milli(seconds: float | None) -> float | None:
    return None if seconds is None else round(seconds * 1e3, 4)


def _utc(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
