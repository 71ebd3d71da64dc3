"""Check the lag of a fixed-lag smoother."""

from __future__ import annotations

from operator import index

from becalm.errors import ModelError

LONGEST_LAG = 1 << 20
"""The longest lag, in readings; the smoother holds a window of this length."""


def checked_lag(lag: int) -> int:
    """Return the lag as a whole number of rows.

    Raises
    ------
    ModelError
        If it is not a whole number, below 0, or above 2^20.
    """
    try:
        rows = index(lag)
    except TypeError as cause:
        raise ModelError(f"lag = {lag!r} is not a number of readings; give a whole number, 0 to filter.") from cause
    if rows > LONGEST_LAG:
        raise ModelError(f"lag = {rows} needs a window of too many readings; give up to {LONGEST_LAG}, or smooth.")
    if rows < 0:
        raise ModelError(f"lag = {rows} is negative; give a whole number, 0 to filter.")
    return rows
