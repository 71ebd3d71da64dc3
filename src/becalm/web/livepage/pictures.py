"""Bins as frames: float32 beside an offset of each channel, and encoded once for all who look on."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.web.frames import Values, frame
from becalm.web.livepage.bins import Bins, Span

_HELD = 16  # frames: those who look on ask for the same ones at the same time


class LivePictures:
    """Frames of a stream's bins.

    Parameters
    ----------
    bins : Bins
        Where they come from.
    channels : int
        m.
    """

    def __init__(self, bins: Bins, channels: int) -> None:
        self._bins, self._channels = bins, channels
        self._held: OrderedDict[tuple[int, int, int], tuple[int, bytes]] = OrderedDict()

    def following(self, level: int, first: int, most: int) -> tuple[int, bytes] | None:
        """Return the bins from `first` on and the number of the bin after them; None where none has closed.

        Bins that have left are told as "gap": how many are missing before the first.
        """
        stop = min(self._bins.newest(level), max(first, self._bins.oldest(level)) + most)
        if stop <= first:
            return None
        key = (level, first, stop)
        if key not in self._held:
            span = self._bins.read(level, first, stop)
            told = self._frame(level, span, {"gap": span.first - first})
            self._held[key] = span.first + len(span), told  # not the span: it is several times as large
            while len(self._held) > _HELD:
                self._held.popitem(last=False)
        return self._held[key]

    def past(self, level: int, first: int, count: int, answers: int) -> bytes:
        """Return some bins that are closed, as far as they are held still."""
        return self._frame(level, self._bins.read(level, first, first + count), {"answers": answers})

    def _frame(self, level: int, span: Span, more: dict[str, Any]) -> bytes:
        m = self._channels
        low, high = span.low.reshape(-1, 2, m), span.high[:, : 3 * m].reshape(-1, 3, m)
        offset = _middles(low, high[:, :2])
        header = {
            "kind": "bins",
            "level": level,
            "first": span.first,
            "count": len(span),
            "channels": m,
            "time_s": float(span.time_s[0]) if len(span) else None,
            "offset": offset.tolist(),
            **more,
        }
        arrays: dict[str, Values] = {
            "t": span.time_s,
            "raw_low": _near(low[:, 0], offset),
            "raw_high": _near(high[:, 0], offset),
            "clean_low": _near(low[:, 1], offset),
            "clean_high": _near(high[:, 1], offset),
            "sigma": high[:, 2].astype(np.float32),
            "verdicts": span.verdicts,
        }
        if span.high.shape[1] > 3 * m:
            arrays["probability"] = span.high[:, 3 * m :].astype(np.float32)
        return frame(header, arrays)


def _middles(low: Floats, high: Floats) -> Floats:
    """Return the middle of each channel's range, (m,): what lies far from zero keeps its digits beside it."""
    least = np.fmin.reduce(low, axis=(0, 1), initial=np.inf)
    most = np.fmax.reduce(high, axis=(0, 1), initial=-np.inf)
    known = least <= most
    return np.where(known, np.where(known, least, 0.0) / 2 + np.where(known, most, 0.0) / 2, 0.0)


def _near(values: Floats, offset: Floats) -> np.ndarray[Any, np.dtype[np.float32]]:
    return (values - offset).astype(np.float32)
