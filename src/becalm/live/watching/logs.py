"""A line for whatever happens to a stream: JSON into a file that never grows too large, or name=value on stderr."""

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

from becalm.files.text_file import refuse_unwritable
from becalm.live.block import Loss, LossKind
from becalm.live.closing import Closing
from becalm.live.optional_libraries import wanted
from becalm.live.watching.secrets import Scrubber

FILE_BYTES, OLD_FILES = 10_000_000, 5
"""When a log file is put aside, and how many of those are kept: 60 MB at most."""

LOSSES_EVERY_S = 60.0
"""How often losses of one kind get a line; the first gets its own at once."""


class Log(Closing):
    """The log of one stream, from which secrets are scrubbed; any thread may write to it.

    A log that cannot be written, on a full disk say, stops no stream: lines are lost until it can.

    Parameters
    ----------
    where : str
        A file for JSON lines, or "-" for name=value lines on stderr.
    environment : mapping of str to str
        Whose secrets never to tell: see `Scrubber`.
    clock : callable
        `time.monotonic`.

    Raises
    ------
    UsageError
        If structlog is not here.
    OutputError
        If there can be no such file.
    """

    def __init__(
        self,
        where: str = "-",
        environment: Mapping[str, str] = os.environ,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        structlog = wanted("--log", "structlog")
        self._where = "stderr" if where == "-" else where
        self._handler = _handler(where)
        self._lines = _lines(structlog, self._handler, Scrubber(environment), as_json=where != "-")
        self._clock = clock
        self._lock = threading.Lock()
        self._pending: dict[LossKind, _Pending] = {}

    def info(self, event: str, **values: object) -> None:
        """Tell what happened: a word or a few, and values with names."""
        self._lines.info(event, **values)

    def warning(self, event: str, **values: object) -> None:
        """Tell what somebody may have to look at."""
        self._lines.warning(event, **values)

    def error(self, event: str, **values: object) -> None:
        """Tell what stopped the stream, or would have."""
        self._lines.error(event, **values)

    def unexpected(self, cause: BaseException) -> str:
        """Tell an error that nobody foresaw, with its traceback; return the sentence for a person."""
        self._lines.error("unexpected", exc_info=cause)
        return (
            f"Something went wrong that becalm did not foresee ({type(cause).__name__}); the log ({self._where}) tells"
            " where. Please report it with those lines."
        )

    def loss(self, loss: Loss) -> None:
        """Tell a loss: the first of its kind at once, later ones once a minute, counted together."""
        now_s = self._clock()
        with self._lock:
            pending = self._pending.setdefault(loss.kind, _Pending(now_s - LOSSES_EVERY_S))
            pending.events += 1
            pending.rows += loss.rows or 0
            pending.last = loss
            self._tell_pending(pending, now_s)

    def turn(self) -> None:
        """Tell what was counted for a minute; to be called now and then."""
        self._tell_all(self._clock())

    def close(self) -> None:
        """Tell what is still counted and let go of the file; harmless twice."""
        self._tell_all(float("inf"))
        self._handler.close()

    def _tell_all(self, now_s: float) -> None:
        with self._lock:
            for pending in self._pending.values():
                self._tell_pending(pending, now_s)

    def _tell_pending(self, pending: _Pending, now_s: float) -> None:
        if pending.last is None or now_s - pending.told_s < LOSSES_EVERY_S:
            return
        values = {"events": pending.events, "rows": pending.rows, "says": pending.last.says}
        self._lines.warning("loss", kind=pending.last.kind.value, **values)
        pending.told_s, pending.events, pending.rows, pending.last = now_s, 0, 0, None


class _Pending:
    """Losses of one kind that no line told yet."""

    def __init__(self, told_s: float) -> None:
        self.told_s = told_s
        self.events = self.rows = 0
        self.last: Loss | None = None


class _RotatingFile(RotatingFileHandler):
    """A log file that is put aside before it grows too large."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802  (its name in the library)
        """Lose the line: there may be no room for it, which is no reason to stop a stream."""


class _Stderr(logging.StreamHandler[Any]):
    """Standard error, which may be closed or full."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802  (its name in the library)
        """Lose the line."""


def _handler(where: str) -> logging.Handler:
    if where == "-":
        return _Stderr(sys.stderr)
    refuse_unwritable(Path(where))
    return _RotatingFile(where, maxBytes=FILE_BYTES, backupCount=OLD_FILES, encoding="utf-8", errors="backslashreplace")


def _lines(structlog: Any, handler: logging.Handler, scrub: Scrubber, *, as_json: bool) -> Any:
    """Return structlog's logger over a handler; nothing global is configured."""
    lines = logging.Logger("becalm.live")  # of its own: what else logs in this process stays apart
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
