"""How much of a file is read at once, to be tuned on or looked at for rest, so that it fits into memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from becalm.errors import RecordingError, UsageError

if TYPE_CHECKING:
    from becalm.core.recording import Recording
    from becalm.files.opening import OpenSource

TUNED_ROWS = 1 << 20
"""Rows that a recipe is tuned on; of longer files, evenly spread stretches."""

TUNED_ROWS_UNEVEN = 1 << 18
"""As many of uneven time, where each row has step matrices of its own."""

REST_ROWS = 1 << 22
"""Rows in which rest is looked for, from the first on: an Allan deviation needs them in a row."""

_MOST_SAMPLES = 1 << 26  # in all channels together


def rows_to_tune_on(source: OpenSource) -> int:
    """Return how many rows tell enough."""
    return _fitting(TUNED_ROWS if source.clock.uniform else TUNED_ROWS_UNEVEN, source)


def beginning(source: OpenSource) -> Recording:
    """Read the first rows, in which stretches of rest are told by their time."""
    return source.stretches([(0, min(source.rows, _fitting(REST_ROWS, source)))])


def cut_short(source: OpenSource, read: Recording) -> str:
    """Say that only the beginning was looked at, if so."""
    if len(read) == source.rows:
        return ""
    return f" Only the first {len(read)} of {source.rows} rows were looked at."


@contextmanager
def rest_within(source: OpenSource, read: Recording) -> Iterator[None]:
    """Turn what is wrong with rest that was said into a mistake in the command, with how much was looked at.

    Raises
    ------
    UsageError
        If a stretch that was said holds too few rows.
    """
    try:
        yield
    except RecordingError as cause:
        raise UsageError(f"{cause}{cut_short(source, read)}") from cause


def _fitting(most: int, source: OpenSource) -> int:
    """Return `most`, or fewer rows where there are many channels."""
    return min(most, max(1 << 16, _MOST_SAMPLES // max(1, len(source.names))))
