"""How many later rows may be waited for."""

from __future__ import annotations

from operator import index

from becalm.errors import ModelError

LONGEST_LAG = 1 << 20
"""Readings, the longest lag: a window of them is held."""


def checked_lag(lag: int) -> int:
    """Return a lag in rows.

    Raises
    ------
    ModelError
        If it is no whole number, below 0, or beyond 2^20.
    """
    try:
        rows = index(lag)
    except TypeError as cause:
        raise ModelError(f"lag = {lag!r} is no number of readings; give a whole number, 0 to filter.") from cause
    if rows > LONGEST_LAG:
        raise ModelError(f"lag = {rows} holds a window of too many readings; give up to {LONGEST_LAG}, or smooth.")
    if rows < 0:
        raise ModelError(f"lag = {rows} would know readings before they come; give a whole number, 0 to filter.")
    return rows
