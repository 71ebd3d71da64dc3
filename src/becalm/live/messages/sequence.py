"""Sort batches by row numbers; detect missing, repeated, late and early rows, and a restart of the sender."""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from becalm.live.block import Loss, LossKind
from becalm.live.messages.reading import MessageRows

WAIT_S = 0.02
"""Time for which an early message waits for the one before it, in seconds."""

_OLD_S = 1.0  # seconds of only old row numbers after which the sender counts as restarted
_OLD_MESSAGES = 3  # least number of messages in this time
_REMEMBERED = 64  # remembered spans of missing rows; a row in them that arrives later is late, not repeated
_QUOTED = 4  # spans listed in a loss


@dataclass
class Sequence:
    """Sorts batches by their row numbers, and returns each row once.

    An early batch waits until more than `reorder` batches wait or 20 ms have passed; the rows before it then count as
    missing. A batch with old numbers counts as repeated, or as late if its rows had counted as missing (such rows are
    counted twice: as missing, and later as late). The sender has restarted if the numbers go back and the stamps
    advance, or if only old, increasing numbers arrive for a second and in three messages.

    Parameters
    ----------
    reorder : int
        Largest number of batches that wait; 0 for a transport that keeps the order.
    rate_hz : float
        Sample rate in hertz. Rows without stamps are stamped by their numbers at this rate, from the arrival of the
        first row since the sender's last start; 0 gives no stamps.
    """

    reorder: int = 0
    rate_hz: float = 0.0
    _next: int | None = None
    _newest_s: float = -np.inf
    _began: tuple[int, float] = (0, 0.0)  # first row since the sender's last start, and its arrival time
    _waiting: list[tuple[int, float, MessageRows]] = field(default_factory=list)
    _ready: list[MessageRows] = field(default_factory=list)
    _missing: list[tuple[int, int]] = field(default_factory=list)
    _recent_missing: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    _counts: dict[LossKind, int] = field(default_factory=dict)
    _restarts: list[Loss] = field(default_factory=list)
    _old: tuple[int, int, float] = (0, 0, 0.0)  # consecutive old batches: count, end row, arrival of the first

    @property
    def state(self) -> dict[str, float | int | None]:
        """Return the state for a restart as values for JSON; waiting batches are not included."""
        newest = self._newest_s if np.isfinite(self._newest_s) else None
        many, end, since_s = self._old
        return {
            "next": self._next,
            "newest_s": newest,
            "began": self._began[0],
            "began_s": self._began[1],
            "behind": many,
            "behind_to": end,
            "behind_s": since_s,
        }

    def resume(self, state: Mapping[str, float | int | None]) -> None:
        """Continue from a state."""
        self._next = None if state["next"] is None else int(state["next"])
        self._newest_s = -np.inf if state["newest_s"] is None else float(state["newest_s"])
        self._began = (int(state["began"] or 0), float(state["began_s"] or 0.0))
        self._old = (int(state["behind"] or 0), int(state["behind_to"] or 0), float(state["behind_s"] or 0.0))

    def take(self, batch: MessageRows, now_s: float) -> None:
        """Add a batch with row numbers.

        Parameters
        ----------
        batch : MessageRows
            Rows with a number `seq`.
        now_s : float
            Time in seconds on a clock that does not jump, the same clock as for `release_due`.
        """
        seq = _number(batch)
        if self._next is None:
            self._add_waiting(batch, now_s)
            if seq == 0 and self._next is None:
                self._release()  # there are no rows before row 0
            return
        if seq < self._next and self._is_restart(batch):
            self._restart(batch)
        elif seq + len(batch) <= self._next:
            self._count(LossKind.LATE if self._was_missing(seq) else LossKind.REPEATED, len(batch))
        elif seq <= self._next:
            self._append(batch)
        else:
            self._add_waiting(batch, now_s)
        self._catch_up()

    def release_due(self, now_s: float) -> None:
        """Release the batches that have waited long enough. Call this after all received batches were added."""
        while self._waiting and now_s - min(since for _, since, _ in self._waiting) >= WAIT_S:
            self._release()

    def wait_s(self, now_s: float) -> float:
        """Return the time until `release_due` must be called, in seconds; infinity if no batch waits."""
        return min((since + WAIT_S - now_s for _, since, _ in self._waiting), default=np.inf)

    def release_all(self) -> None:
        """Release all waiting batches."""
        while self._waiting:
            self._release()

    def ready(self) -> list[MessageRows]:
        """Return the sorted batches since the last call."""
        ready, self._ready = self._ready, []
        return ready

    def losses(self) -> tuple[Loss, ...]:
        """Return the losses since the last call."""
        losses = self._restarts
        if self._missing:
            rows = sum(end - first for first, end in self._missing)
            spans = ", ".join(f"{first} to {end - 1}" for first, end in self._missing[:_QUOTED])
            more = len(self._missing) - _QUOTED
            losses.append(
                Loss(
                    LossKind.MISSING,
                    rows,
                    f"Rows {spans}{f' and {more} more spans' if more > 0 else ''} did not arrive.",
                )
            )
        for kind, rows in self._counts.items():
            how = "arrived after later rows" if kind is LossKind.LATE else "arrived again"
            losses.append(Loss(kind, rows, f"{rows} rows {how}; they were left out."))
        self._restarts, self._missing, self._counts = [], [], {}
        return tuple(losses)

    def _add_waiting(self, batch: MessageRows, now_s: float) -> None:
        seq = _number(batch)
        if any(number == seq and len(batch) <= len(other) for number, _, other in self._waiting):
            self._count(LossKind.REPEATED, len(batch))
            return
        insort(self._waiting, (seq, now_s, batch), key=lambda item: item[0])
        while len(self._waiting) > self.reorder:
            self._release()

    def _release(self) -> None:
        """Count the rows before the first waiting batch as missing, and continue with that batch."""
        first, _, batch = self._waiting[0]
        if self._next is None:
            self._began = (first, batch.arrived_s)
        elif first > self._next:
            self._missing.append((self._next, first))
            self._recent_missing.append((self._next, first))
        self._next = first
        self._catch_up()

    def _catch_up(self) -> None:
        """Append the waiting batches that now follow without a gap."""
        while self._waiting and self._next is not None and self._waiting[0][0] <= self._next:
            batch = self._waiting.pop(0)[2]
            if _number(batch) + len(batch) > self._next:
                self._append(batch)
            else:
                self._count(LossKind.REPEATED, len(batch))

    def _append(self, batch: MessageRows) -> None:
        """Append the new rows of a batch that contains the next row."""
        old = (self._next or 0) - _number(batch)
        if old:
            self._count(LossKind.REPEATED, old)
            batch = batch.after(old)
        seq = _number(batch)
        self._next = seq + len(batch)
        self._old = (0, 0, 0.0)
        if batch.time_s is not None:
            self._newest_s = max(self._newest_s, float(batch.time_s.max()))
        elif self.rate_hz:
            steps = np.arange(seq - self._began[0], self._next - self._began[0])
            batch = MessageRows(seq, self._began[1] + steps / self.rate_hz, batch.values, batch.arrived_s)
        self._ready.append(batch)

    def _was_missing(self, seq: int) -> bool:
        return any(first <= seq < end for first, end in self._recent_missing)

    def _count(self, kind: LossKind, rows: int) -> None:
        self._counts[kind] = self._counts.get(kind, 0) + rows

    def _is_restart(self, batch: MessageRows) -> bool:
        """Return whether a batch with old numbers is from a restarted sender, by stamps or by arrival times."""
        if batch.time_s is not None and batch.time_s[0] > self._newest_s:
            return True
        if _number(batch) + len(batch) > (self._next or 0):
            return False
        many, end, since_s = self._old
        if not many or _number(batch) < end:
            many, since_s = 0, batch.arrived_s
        self._old = (many + 1, _number(batch) + len(batch), since_s)
        return many + 1 >= _OLD_MESSAGES and batch.arrived_s - since_s >= _OLD_S

    def _restart(self, batch: MessageRows) -> None:
        self.release_all()  # release the batches of the previous run
        seq = _number(batch)
        text = f"The sender restarted at row {seq}; the last row of its previous run was {(self._next or 0) - 1}."
        self._restarts.append(Loss(LossKind.GAP, None, text))
        self._next, self._newest_s, self._began = seq, -np.inf, (seq, batch.arrived_s)
        self._recent_missing.clear()
        self._append(batch)


def _number(batch: MessageRows) -> int:
    """Return the row number of a batch; batches without a number are not sorted."""
    if batch.seq is None:
        raise TypeError("a batch without a row number cannot be sorted")
    return batch.seq
