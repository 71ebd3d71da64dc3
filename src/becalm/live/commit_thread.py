"""The thread that commits rows, filters and position, while the next rows are filtered."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from becalm.live.block import Checkpoint, Head, Loss, LossKind, Output
from becalm.live.outlet import Outlet
from becalm.live.protocols import AwayError, Keeper, Source, StorageFullError
from becalm.live.reader import BackOff
from becalm.live.watching.watch import Watch

_BATCHES = 2  # that wait for a slow disk, before the filters do
_POLL_S = 0.25


class Transaction(NamedTuple):
    """What is kept in one transaction."""

    outputs: list[Output]
    checkpoint: Checkpoint


class Outlets(NamedTuple):
    """Where a stream goes: one that keeps it, if any, and others."""

    keeper: Keeper | None
    others: tuple[Outlet, ...]


class Keeping:
    """Keeps batches in a thread of its own, in order; a keeper that is full or away is tried again until it is not.

    Parameters
    ----------
    outlets : Outlets
        Sinks are flushed before a batch is kept, so that what is kept is with everyone.
    source : Source
        Hears which position is kept.
    watch : Watch
        Hears of each commit, and of trouble.
    head : Head
        What every row shares.
    """

    def __init__(self, outlets: Outlets, source: Source, watch: Watch, head: Head) -> None:
        self._outlets, self._source, self._watch, self._head = outlets, source, watch, head
        self._batches: queue.Queue[Transaction | None] = queue.Queue(_BATCHES)
        self._giving_up = threading.Event()
        self._failure: BaseException | None = None
        self._losses: list[Loss] = []
        self._in_doubt = False  # whether the last batch was kept before the keeper went away
        self._thread = threading.Thread(target=self._run, name="keeper", daemon=True)
        self._thread.start()

    def give(self, batch: Transaction) -> None:
        """Hand a batch over; wait while those before it wait for the disk.

        Raises
        ------
        BecalmError
            If an earlier one can never be kept.
        """
        while True:
            self._refuse()
            try:
                self._batches.put(batch, timeout=_POLL_S)
            except queue.Full:
                continue
            return

    def losses(self) -> tuple[Loss, ...]:
        """Return what happened to storage since this was last asked."""
        taken, self._losses = self._losses, []
        return tuple(taken)

    def finish(self, patience_s: float) -> None:
        """Keep what was handed over; give up on a full disk or an absent server after some seconds.

        Raises
        ------
        BecalmError
            If something could not be kept.
        """
        until = time.monotonic() + patience_s
        while self._thread.is_alive():
            try:
                self._batches.put(None, timeout=_POLL_S)
                break
            except queue.Full:
                if time.monotonic() > until:
                    self._giving_up.set()
        self._thread.join(max(0.0, until - time.monotonic()))
        self._giving_up.set()
        self._thread.join()
        self._refuse()

    def _refuse(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        try:
            while (batch := self._batches.get()) is not None:
                self._keep(batch)
        except BaseException as cause:  # the runner raises it
            self._failure = cause

    def _keep(self, batch: Transaction) -> None:
        begun = time.monotonic()
        for outlet in self._outlets.others:
            self._insist(outlet.flush, outlet.away)
        if self._outlets.keeper is not None:
            self._insist(partial(self._keep_once, batch), self._keeper_away)
        rows = sum(len(output) for output in batch.outputs)
        self._watch.meter.kept(rows, time.monotonic() - begun, batch.checkpoint.position)
        self._source.committed(batch.checkpoint.position)

    def _keep_once(self, batch: Transaction) -> None:
        keeper = self._outlets.keeper
        assert keeper is not None
        if self._in_doubt:
            last = keeper.last()
            keeper.open(self._head)
            self._in_doubt = False
            if last is not None and last == batch.checkpoint:
                return  # it was kept before the other end went away
        keeper.keep(batch.outputs, batch.checkpoint)

    def _insist(self, do: Callable[[], None], away: Callable[[], None]) -> None:
        """Do something until it is done, however long the disk is full or the other end away."""
        back_off, troubled = BackOff(), False
        while True:
            try:
                do()
            except (StorageFullError, AwayError) as cause:
                if isinstance(cause, AwayError):
                    away()
                if not troubled:
                    self._tell(LossKind.STORAGE if isinstance(cause, StorageFullError) else LossKind.AWAY, str(cause))
                troubled = True
                if self._giving_up.is_set():
                    raise
                back_off.wait(self._giving_up)
                continue
            if troubled:
                self._watch.state("running")
            return

    def _keeper_away(self) -> None:
        assert self._outlets.keeper is not None
        self._outlets.keeper.close()
        self._in_doubt = True

    def _tell(self, kind: LossKind, says: str) -> None:
        self._watch.state("full" if kind is LossKind.STORAGE else "away", says)
        self._losses.append(Loss(kind, None, says))
