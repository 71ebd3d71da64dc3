"""Sort integer time stamps of messages, and convert them to seconds without losing digits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from becalm.core.arrays import Floats, Integers

_FIRST, _LAST = 946_684_800 * 10**9, 4_102_444_800 * 10**9  # ns since 1970: stamps from 2000 to 2100 count as dates


class Ordered(NamedTuple):
    """Sorted stamps.

    Attributes
    ----------
    stamps : (N,) int64 array
        The stamps in ascending order.
    order : (N,) int64 array or None
        Indices that sort the messages; None if they were in order.
    notes : tuple of str
        A sentence for the user if they were not in order.
    """

    stamps: Integers
    order: Integers | None
    notes: tuple[str, ...] = ()


def in_order(stamps: Integers) -> Ordered:
    """Sort stamps; equal stamps keep their order."""
    late = int(np.count_nonzero(np.diff(stamps) < 0))
    if not late:
        return Ordered(stamps, None)
    order = np.argsort(stamps, kind="stable")
    return Ordered(
        stamps[order], order, (f"Messages came out of order ({late:,} times) and were sorted by their time.",)
    )


def seconds_of(stamps: Integers, per_second: int, origin: int | None = None) -> Floats:
    """Return the seconds since `origin`, by default the first stamp; the subtraction is in integers."""
    if not len(stamps):
        return np.empty(0)
    since: Floats = (stamps - np.int64(stamps[0] if origin is None else origin)) / per_second
    return since


def instant(stamps_ns: Integers) -> str:
    """Return the first stamp as ISO 8601 text, "" if the stamps are not nanoseconds since 1970."""
    if not len(stamps_ns) or not _FIRST <= int(stamps_ns[0]) <= _LAST:
        return ""
    return str(np.datetime64(int(stamps_ns[0]), "ns")) + "Z"
