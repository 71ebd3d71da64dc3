"""A thread that writes completed hours of a journal to Parquet files while the stream continues."""

from __future__ import annotations

import logging
import time
from collections import deque
from contextlib import closing
from pathlib import Path
from threading import Event, Lock, Thread

from becalm.live.journal.database import NAME, connect_reading, last_rolled_block
from becalm.live.journal.parquet_files import remove
from becalm.live.journal.records import RollRow
from becalm.live.journal.rolling import Rolled, Stopped, next_piece, roll

_RETRY_S = 60.0  # seconds until a failed write is tried again; a completed hour ends the wait
_log = logging.getLogger(__name__)


class Roller:
    """Writes completed hours to Parquet files; a file is valid once the next commit of the journal has recorded it.

    Parameters
    ----------
    folder : Path
        Folder of the journal.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._after = 0  # number of the last block that is in a file
        self._done: deque[Rolled] = deque()
        self._wake, self._stop, self._idle = Event(), Event(), Event()
        self._unwanted: deque[RollRow] = deque()
        self._lock = Lock()  # guards the events wake and idle
        self._troubled = False
        self._thread = Thread(target=self._work, name="becalm-roller", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """Wake the thread, because an hour may be completed."""
        with self._lock:
            self._idle.clear()
            self._wake.set()

    def done(self) -> tuple[Rolled, ...]:
        """Return the files that were written and are not recorded yet, in order."""
        return tuple(self._done)

    def forget(self, recorded: int, unwanted: list[RollRow]) -> None:
        """Drop the first `recorded` files of `done`, which are now recorded, and remove the `unwanted` old files."""
        for _ in range(recorded):
            self._done.popleft()
        if unwanted:
            self._unwanted.extend(unwanted)
            self.wake()

    def wait_until_rolled(self, timeout_s: float) -> bool:
        """Wait until all completed hours are written; return False after the timeout or a failure."""
        return self._idle.wait(timeout_s) and not self._troubled

    def close(self) -> None:
        """Stop, possibly in the middle of a file; the next start writes that file again."""
        self._stop.set()
        self._wake.set()
        self._thread.join()

    def _work(self) -> None:
        self.wake()
        while not self._stop.is_set():
            self._wake.wait(_RETRY_S if self._troubled else None)
            with self._lock:
                self._wake.clear()
            try:
                self._roll_all()
                self._troubled = False
            except Stopped:
                return
            except Exception as cause:  # no error here may stop the stream; the next start checks the journal
                self._troubled = True
                _log.warning("No row is lost, but %s could not be written to Parquet: %s", self._folder, cause)
            with self._lock:
                if not self._wake.is_set():
                    self._idle.set()

    def _roll_all(self) -> None:
        while self._unwanted:
            remove(self._folder, [self._unwanted.popleft()])
        with closing(connect_reading(self._folder / NAME)) as connection:
            self._after = max(self._after, last_rolled_block(connection))
            while not self._stop.is_set() and (piece := next_piece(connection, self._after)) is not None:
                began_s = time.monotonic()
                self._done.append(roll(connection, self._folder, piece, self._stop))
                self._after = piece.last_block
                took_s = time.monotonic() - began_s
                _log.info("Rolled rows %d to %d in %.1f s", piece.first_row, piece.end_row - 1, took_s)
