"""Row numbers in order: what is missing, what came twice, late or ahead, and when a sender begins anew."""

from __future__ import annotations

from bisect import insort
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from becalm.live.block import Loss, LossKind
from becalm.live.messages.reading import MessageRows

WAIT_S = 0.02
"""How long a message that came ahead waits for the one before."""

_BEHIND_S = 1.0  # messages that only have numbers long told are a new run after this long...
_BEHIND = 3  # ...and this many
_REMEMBERED = 64  # stretches of missing rows, so that what comes of them later is called late and not repeated
_QUOTED = 4  # stretches named in a loss


@dataclass
class Sequence:
    """Puts batches in order by their rows' numbers. It is told all that comes, and tells each row once.

    A batch that is ahead waits until `reorder` others wait or 20 ms are over; then the rows before it are missing.
    A batch with numbers that were told before is repeated, or late where it had been missed (and then counted twice:
    missing, later late). One whose numbers go back while its stamps go on is of a sender that began anew. So is,
    where stamps do not tell, one after which nothing but numbers told before came for a second.

    Parameters
    ----------
    reorder : int
        How many batches may wait; 0 of a transport that keeps the order.
    rate_hz : float
        Rows a second: numbers tell the time of rows without stamps, from the arrival of the run's first. 0 tells none.
    """

    reorder: int = 0
    rate_hz: float = 0.0
    _next: int | None = None
    _newest_s: float = -np.inf
    _began: tuple[int, float] = (0, 0.0)  # the run's first row, and when it came
    _held: list[tuple[int, float, MessageRows]] = field(default_factory=list)
    _ready: list[MessageRows] = field(default_factory=list)
    _missing: list[tuple[int, int]] = field(default_factory=list)
    _missed: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    _counts: dict[LossKind, int] = field(default_factory=dict)
    _said: list[Loss] = field(default_factory=list)
    _behind: tuple[int, int, float] = (0, 0, 0.0)  # how many, up to which row, since when

    @property
    def state(self) -> dict[str, float | int | None]:
        """What a restart needs, as plain values for JSON; without what waits to be told."""
        newest = self._newest_s if np.isfinite(self._newest_s) else None
        many, end, since_s = self._behind
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
        """Go on after a state."""
        self._next = None if state["next"] is None else int(state["next"])
        self._newest_s = -np.inf if state["newest_s"] is None else float(state["newest_s"])
        self._began = (int(state["began"] or 0), float(state["began_s"] or 0.0))
        self._behind = (int(state["behind"] or 0), int(state["behind_to"] or 0), float(state["behind_s"] or 0.0))

    def take(self, batch: MessageRows, now_s: float) -> None:
        """Hear of a batch with numbers.

        Parameters
        ----------
        batch : MessageRows
            With its `seq`.
        now_s : float
            The time of any clock that does not jump; the same for `due`.
        """
        seq = _number(batch)
        if self._next is None:
            self._hold(batch, now_s)
            if seq == 0 and self._next is None:
                self._release()  # nothing comes before it
            return
        if seq < self._next and self._is_anew(batch):
            self._begin(batch)
        elif seq + len(batch) <= self._next:
            self._count(LossKind.LATE if self._was_missed(seq) else LossKind.REPEATED, len(batch))
        elif seq <= self._next:
            self._tell(batch)
        else:
            self._hold(batch, now_s)
        self._catch_up()

    def due(self, now_s: float) -> None:
        """Let go what waited long enough. To be called after all that has come was taken."""
        while self._held and now_s - min(since for _, since, _ in self._held) >= WAIT_S:
            self._release()

    def wait_s(self, now_s: float) -> float:
        """Return how long `due` may be put off; infinite where nothing waits."""
        return min((since + WAIT_S - now_s for _, since, _ in self._held), default=np.inf)

    def rest(self) -> None:
        """Let go all that waits: nothing more will come."""
        while self._held:
            self._release()

    def ready(self) -> list[MessageRows]:
        """Return the batches that follow, and forget them."""
        ready, self._ready = self._ready, []
        return ready

    def losses(self) -> tuple[Loss, ...]:
        """Return what happened since this was asked last."""
        said = self._said
        if self._missing:
            rows = sum(end - first for first, end in self._missing)
            stretches = ", ".join(f"{first} to {end - 1}" for first, end in self._missing[:_QUOTED])
            more = len(self._missing) - _QUOTED
            said.append(
                Loss(
                    LossKind.MISSING,
                    rows,
                    f"Rows {stretches}{f' and {more} stretches more' if more > 0 else ''} did not come.",
                )
            )
        for kind, rows in self._counts.items():
            how = "came after rows that follow them" if kind is LossKind.LATE else "came again"
            said.append(Loss(kind, rows, f"{rows} rows {how}; they are left out."))
        self._said, self._missing, self._counts = [], [], {}
        return tuple(said)

    def _hold(self, batch: MessageRows, now_s: float) -> None:
        seq = _number(batch)
        if any(held == seq and len(batch) <= len(other) for held, _, other in self._held):
            self._count(LossKind.REPEATED, len(batch))
            return
        insort(self._held, (seq, now_s, batch), key=lambda held: held[0])
        while len(self._held) > self.reorder:
            self._release()

    def _release(self) -> None:
        """Give up what lies before the first that waits."""
        first, _, batch = self._held[0]
        if self._next is None:
            self._began = (first, batch.arrived_s)
        elif first > self._next:
            self._missing.append((self._next, first))
            self._missed.append((self._next, first))
        self._next = first
        self._catch_up()

    def _catch_up(self) -> None:
        while self._held and self._next is not None and self._held[0][0] <= self._next:
            batch = self._held.pop(0)[2]
            if _number(batch) + len(batch) > self._next:
                self._tell(batch)
            else:
                self._count(LossKind.REPEATED, len(batch))

    def _tell(self, batch: MessageRows) -> None:
        """Take the new rows of a batch that holds the next."""
        old = (self._next or 0) - _number(batch)
        if old:
            self._count(LossKind.REPEATED, old)
            batch = batch.after(old)
        seq = _number(batch)
        self._next = seq + len(batch)
        self._behind = (0, 0, 0.0)
        if batch.time_s is not None:
            self._newest_s = max(self._newest_s, float(batch.time_s.max()))
        elif self.rate_hz:
            steps = np.arange(seq - self._began[0], self._next - self._began[0])
            batch = MessageRows(seq, self._began[1] + steps / self.rate_hz, batch.values, batch.arrived_s)
        self._ready.append(batch)

    def _was_missed(self, seq: int) -> bool:
        return any(first <= seq < end for first, end in self._missed)

    def _count(self, kind: LossKind, rows: int) -> None:
        self._counts[kind] = self._counts.get(kind, 0) + rows

    def _is_anew(self, batch: MessageRows) -> bool:
        """Return whether a batch that goes back is of a new run; by arrivals, which a replay tells again."""
        if batch.time_s is not None and batch.time_s[0] > self._newest_s:
            return True
        if _number(batch) + len(batch) > (self._next or 0):
            return False
        many, end, since_s = self._behind
        if not many or _number(batch) < end:
            many, since_s = 0, batch.arrived_s
        self._behind = (many + 1, _number(batch) + len(batch), since_s)
        return many + 1 >= _BEHIND and batch.arrived_s - since_s >= _BEHIND_S

    def _begin(self, batch: MessageRows) -> None:
        self.rest()  # of the run before
        seq = _number(batch)
        says = f"The sender began anew at row {seq}; its last run had told rows up to {(self._next or 0) - 1}."
        self._said.append(Loss(LossKind.GAP, None, says))
        self._next, self._newest_s, self._began = seq, -np.inf, (seq, batch.arrived_s)
        self._missed.clear()
        self._tell(batch)


def _number(batch: MessageRows) -> int:
    """Return a batch's number; streams without never come here."""
    if batch.seq is None:
        raise TypeError("a batch without a number has no place in a sequence")
    return batch.seq
