"""A file that says every second how a stream fares, whole or not at all."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from becalm.files.text_file import refuse_unwritable
from becalm.live.closing import Closing
from becalm.live.watching.meter import Meter
from becalm.live.watching.secrets import Scrubber

EVERY_S = 1.0


class StatusFile(Closing):
    """Writes `Meter.status` as JSON, every second from a thread of its own and once more at the end.

    Secrets are scrubbed from it as from a log. A status that cannot be written, on a full disk say, stops no stream:
    it is said once, and tried again.

    Parameters
    ----------
    path : Path
        The file; it is replaced by renaming, so that who reads it finds a whole one.
    meter : Meter
        What to tell.
    say : callable
        Hears a sentence when writing fails, and when it works again.

    Raises
    ------
    OutputError
        If no file can have such a name, or none can be made in its folder.
    """

    def __init__(self, path: Path, meter: Meter, say: Callable[[str], object]) -> None:
        refuse_unwritable(path)
        self._path, self._meter, self._say, self._scrub = path, meter, say, Scrubber()
        self._part = path.with_name(f".{path.name}.part")
        self._failing = False
        self._ended = threading.Event()
        self._write()
        self._thread = threading.Thread(target=self._keep_writing, name="status", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write the last one and stop; harmless twice."""
        if not self._ended.is_set():
            self._ended.set()
            self._thread.join()
            self._write()

    def _keep_writing(self) -> None:
        while not self._ended.wait(EVERY_S):
            self._write()

    def _write(self) -> None:
        """Replace the file; it is not forced to the disk, which the journal needs more."""
        text = json.dumps(self._scrub.value(self._meter.status()), indent=2, allow_nan=False) + "\n"
        try:
            self._part.write_text(text, encoding="utf-8")
            self._part.replace(self._path)
        except OSError as cause:
            with suppress(OSError):
                self._part.unlink(missing_ok=True)
            if not self._failing:
                self._say(f"The status file {self._path} cannot be written ({cause.strerror}); the stream goes on.")
            self._failing = True
        else:
            if self._failing:
                self._say(f"The status file {self._path} is written again.")
            self._failing = False
