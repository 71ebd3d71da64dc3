"""Log the events of a stream: JSON lines in a rotated file of bounded size, or name=value lines on stderr."""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from logging.handlers import RotatingFileHandler
from pathlib import Path
from typing import Any

from becalm.files.atomic_file import refuse_unwritable
from becalm.live.block import Loss, LossKind
from becalm.live.closing import Closing
from becalm.live.optional_libraries import import_optional
from becalm.live.watching.scrubber import Scrubber

FILE_BYTES, OLD_FILES = 10_000_000, 5
"""Size in bytes at which a log file is rotated, and number of old files that are kept: at most 60 MB in all."""

LOSSES_EVERY_S = 60.0
"""Least interval between log lines for losses of one kind, in seconds; the first loss is logged at once."""


class Log(Closing):
    """The log of one stream, without secrets; any thread may write to it.

    If the log cannot be written, for example on a full disk, the stream continues and lines are lost.

    Parameters
    ----------
    where : str
        Path of a file for JSON lines, or "-" for name=value lines on stderr.
    environment : mapping of str to str
        Environment variables whose secrets are never logged: see `Scrubber`.
    clock : callable
        Function that returns the time in seconds; by default `time.monotonic`.

    Raises
    ------
    UsageError
        If structlog is not installed.
    OutputError
        If the file cannot be created.
    """

    def __init__(
        self,
        where: str = "-",
        environment: Mapping[str, str] = os.environ,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        structlog = import_optional("--log", "structlog")
        self._where = "stderr" if where == "-" else where
        self._handler = _handler(where)
        self._logger = _make_logger(structlog, self._handler, Scrubber(environment), as_json=where != "-")
        self._clock = clock
        self._lock = threading.Lock()
        self._pending: dict[LossKind, _Pending] = {}

    def info(self, event: str, **values: object) -> None:
        """Log an event: a few words, and named values."""
        self._logger.info(event, **values)

    def warning(self, event: str, **values: object) -> None:
        """Log an event that the user may have to check."""
        self._logger.warning(event, **values)

    def error(self, event: str, **values: object) -> None:
        """Log an error that stopped the stream, or a refused request."""
        self._logger.error(event, **values)

    def unexpected(self, cause: BaseException) -> str:
        """Log an unexpected error with its traceback; return a message for the user."""
        self._logger.error("unexpected", exc_info=cause)
        return (
            f"An unexpected error occurred in becalm ({type(cause).__name__}); the log ({self._where}) shows where."
            " Please report it with those lines."
        )

    def loss(self, loss: Loss) -> None:
        """Log a loss: the first of its kind at once, later ones once a minute with their sum."""
        now_s = self._clock()
        with self._lock:
            pending = self._pending.setdefault(loss.kind, _Pending(now_s - LOSSES_EVERY_S))
            pending.events += 1
            pending.rows += loss.rows or 0
            pending.last = loss
            self._log_pending(pending, now_s)

    def log_due_losses(self) -> None:
        """Log the counted losses of each kind that was last logged a minute ago; to be called every few seconds."""
        self._log_all(self._clock())

    def close(self) -> None:
        """Log the losses that are not logged yet, and close the file; may be called twice."""
        self._log_all(float("inf"))
        self._handler.close()

    def _log_all(self, now_s: float) -> None:
        with self._lock:
            for pending in self._pending.values():
                self._log_pending(pending, now_s)

    def _log_pending(self, pending: _Pending, now_s: float) -> None:
        if pending.last is None or now_s - pending.logged_s < LOSSES_EVERY_S:
            return
        values = {"events": pending.events, "rows": pending.rows, "says": pending.last.says}
        self._logger.warning("loss", kind=pending.last.kind.value, **values)
        pending.logged_s, pending.events, pending.rows, pending.last = now_s, 0, 0, None


class _Pending:
    """Losses of one kind that are counted but not logged yet."""

    def __init__(self, logged_s: float) -> None:
        self.logged_s = logged_s
        self.events = self.rows = 0
        self.last: Loss | None = None


class _RotatingFile(RotatingFileHandler):
    """A log file that is rotated before it grows too large."""

    def doRollover(self) -> None:  # noqa: N802  (its name in the library)
        """Rotate the files; if this one cannot be renamed, let it grow, and try again later.

        Windows renames no file that a viewer holds open.
        """
        if self.stream is not None:
            self.stream.close()
            self.stream = None  # as the library does: the next line opens it
        path = Path(self.baseFilename)
        try:
            path.replace(path)  # fails before the older files are moved
        except PermissionError:
            self.maxBytes += FILE_BYTES
            return
        super().doRollover()
        self.maxBytes = FILE_BYTES

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802  (its name in the library)
        """Drop the line; a full disk must not stop the stream."""


class _Stderr(logging.StreamHandler[Any]):
    """Standard error, which may be closed or full."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802  (its name in the library)
        """Drop the line."""


def _handler(where: str) -> logging.Handler:
    if where == "-":
        return _Stderr(sys.stderr)
    refuse_unwritable(Path(where))
    return _RotatingFile(where, maxBytes=FILE_BYTES, backupCount=OLD_FILES, encoding="utf-8", errors="backslashreplace")


def _make_logger(structlog: Any, handler: logging.Handler, scrub: Scrubber, *, as_json: bool) -> Any:
    """Return a structlog logger that writes to a handler; global logging is not configured."""
    lines = logging.Logger("becalm.live")  # not from getLogger: other logs of this process stay separate
    lines.addHandler(handler)
    order = ["timestamp", "level", "event"]
    return structlog.wrap_logger(
        lines,
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            scrub,
            structlog.processors.JSONRenderer() if as_json else structlog.processors.LogfmtRenderer(key_order=order),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        cache_logger_on_first_use=True,
    )
