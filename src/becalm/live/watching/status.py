"""Write the status of a stream to a file every second, atomically."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from becalm.files.atomic_file import refuse_unwritable
from becalm.live.closing import Closing
from becalm.live.watching.meter import Meter
from becalm.live.watching.scrubber import Scrubber

EVERY_S = 1.0
"""Interval between writes, in seconds."""


class StatusFile(Closing):
    """Writes `Meter.status` as JSON, every second from a separate thread and once more at the end.

    Secrets are removed as in a log. If the file cannot be written, for example on a full disk, the stream continues;
    the failure is reported once, and writing is tried again.

    Parameters
    ----------
    path : Path
        The file; it is replaced by renaming, so that a reader always finds a complete file.
    meter : Meter
        Meter with the counts.
    report : callable
        Called with a sentence when writing fails, and when it works again.

    Raises
    ------
    OutputError
        If the file name is not possible, or no file can be created in its folder.
    """

    def __init__(self, path: Path, meter: Meter, report: Callable[[str], object]) -> None:
        refuse_unwritable(path)
        self._path, self._meter, self._report, self._scrub = path, meter, report, Scrubber()
        self._part = path.with_name(f".{path.name}.part")
        self._failing = False
        self._ended = threading.Event()
        self._write()
        self._thread = threading.Thread(target=self._keep_writing, name="status", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write the last status and stop; may be called twice."""
        if not self._ended.is_set():
            self._ended.set()
            self._thread.join()
            self._write()

    def _keep_writing(self) -> None:
        while not self._ended.wait(EVERY_S):
            self._write()

    def _write(self) -> None:
        """Replace the file, without fsync, because that would slow the journal's commits."""
        text = json.dumps(self._scrub.scrub_value(self._meter.status()), indent=2, allow_nan=False) + "\n"
        try:
            self._part.write_text(text, encoding="utf-8")
            self._part.replace(self._path)
        except OSError as cause:
            with suppress(OSError):
                self._part.unlink(missing_ok=True)
            if not self._failing:
                self._report(
                    f"The status file {self._path} cannot be written ({cause.strerror}); the stream continues."
                )
            self._failing = True
        else:
            if self._failing:
                self._report(f"The status file {self._path} is written again.")
            self._failing = False
