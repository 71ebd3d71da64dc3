"""The thread that rolls closed hours while the stream goes on."""

from __future__ import annotations

import logging
import time
from collections import deque
from contextlib import closing
from pathlib import Path
from threading import Event, Lock, Thread

from becalm.live.journal.database import NAME, connect_reading, rolled_blocks
from becalm.live.journal.recording import remove
from becalm.live.journal.records import RollRow
from becalm.live.journal.rolling import Rolled, Stopped, next_piece, roll

_AGAIN_S = 60.0  # after a file could not be written, if no hour closes before
_log = logging.getLogger(__name__)


class Roller:
    """Writes files of closed hours; they count once the keeper has recorded them, with its next block.

    Parameters
    ----------
    folder : Path
        Of the journal.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._after = 0  # the last block that has rolled
        self._done: deque[Rolled] = deque()
        self._wake, self._stop, self._idle = Event(), Event(), Event()
        self._unwanted: deque[RollRow] = deque()
        self._lock = Lock()  # of the two events wake and idle
        self._troubled = False
        self._thread = Thread(target=self._work, name="becalm-roller", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Hear that an hour may have closed."""
        with self._lock:
            self._idle.clear()
            self._wake.set()

    def done(self) -> tuple[Rolled, ...]:
        """Return what was rolled, and not forgotten, in order."""
        return tuple(self._done)

    def forget(self, recorded: int, unwanted: list[RollRow]) -> None:
        """Hear that the first so many of those are recorded, and that these older files are to be removed."""
        for _ in range(recorded):
            self._done.popleft()
        if unwanted:
            self._unwanted.extend(unwanted)
            self.wake()

    def settle(self, timeout_s: float) -> bool:
        """Wait until nothing is left to roll, and tell whether that is so; a file that cannot be written is left."""
        return self._idle.wait(timeout_s) and not self._troubled

    def close(self) -> None:
        """Stop, in the middle of a file if need be: the next start writes it anew."""
        self._stop.set()
        self._wake.set()
        self._thread.join()

    def _work(self) -> None:
        self.wake()
        while not self._stop.is_set():
            self._wake.wait(_AGAIN_S if self._troubled else None)
            with self._lock:
                self._wake.clear()
            try:
                self._roll_all()
                self._troubled = False
            except Stopped:
                return
            except Exception as cause:  # whatever it is, the stream goes on, and the next start looks into it
                self._troubled = True
                _log.warning("No row is lost, but %s did not roll into Parquet: %s", self._folder, cause)
            with self._lock:
                if not self._wake.is_set():
                    self._idle.set()

    def _roll_all(self) -> None:
        while self._unwanted:
            remove(self._folder, [self._unwanted.popleft()])
        with closing(connect_reading(self._folder / NAME)) as connection:
            self._after = max(self._after, rolled_blocks(connection))
            while not self._stop.is_set() and (piece := next_piece(connection, self._after)) is not None:
                begun = time.monotonic()
                self._done.append(roll(connection, self._folder, piece, self._stop))
                self._after = piece.last_block
                _log.info("Rolled rows %d to %d in %.1f s", piece.first_row, piece.end_row, time.monotonic() - begun)
