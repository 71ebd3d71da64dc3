"""Limit how many rows are read into memory to tune a recipe or to find intervals at rest."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from becalm.errors import RecordingError, UsageError

if TYPE_CHECKING:
    from becalm.core.recording import Recording
    from becalm.files.inputs.opening import OpenSource

TUNED_ROWS = 1 << 20
"""The most rows to tune a recipe on; a longer file is represented by evenly spaced stretches of rows."""

TUNED_ROWS_UNEVEN = 1 << 18
"""The most rows to tune a recipe on if the time is uneven, because then each row needs its own step matrices."""

REST_ROWS = 1 << 22
"""The most rows to search for rest: the first rows of the file, as an Allan deviation needs consecutive rows."""

_MOST_SAMPLES = 1 << 26  # most values of all channels together


def rows_to_tune_on(source: OpenSource) -> int:
    """Return how many rows to tune a recipe on."""
    return _limited(TUNED_ROWS if source.clock.uniform else TUNED_ROWS_UNEVEN, source)


def read_beginning(source: OpenSource) -> Recording:
    """Read the first rows of a file, up to the number that is searched for rest."""
    return source.stretches([(0, min(source.rows, _limited(REST_ROWS, source)))])


def unused_rows_note(source: OpenSource, read: Recording) -> str:
    """Return a sentence that says that only the first rows were used; "" if all were."""
    if len(read) == source.rows:
        return ""
    return f" Only the first {len(read)} of {source.rows} rows were used."


@contextmanager
def explain_rest_errors(source: OpenSource, read: Recording) -> Iterator[None]:
    """Turn an error about an interval of rest from the command line into a UsageError, with the number of rows used.

    Raises
    ------
    UsageError
        If a given interval holds too few rows.
    """
    try:
        yield
    except RecordingError as cause:
        raise UsageError(f"{cause}{unused_rows_note(source, read)}") from cause


def _limited(most: int, source: OpenSource) -> int:
    """Return `most`, or fewer rows if there are many channels, but at least 65,536."""
    return min(most, max(1 << 16, _MOST_SAMPLES // max(1, len(source.names))))
