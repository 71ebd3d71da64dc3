"""Encode bins as frames, once for all viewers; values are float32 differences from an offset for each channel."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import numpy as np

from becalm.core.arrays import Floats
from becalm.web.frames import Values, frame
from becalm.web.livepage.bins import Bins, Span

_CACHED = 16  # frames in the cache; viewers request the same frame at about the same time


class LivePictures:
    """Encodes and caches frames with the bins of a stream.

    Parameters
    ----------
    bins : Bins
        Bins of the stream.
    channels : int
        Number of channels, m.
    """

    def __init__(self, bins: Bins, channels: int) -> None:
        self._bins, self._channels = bins, channels
        self._cache: OrderedDict[tuple[int, int, int], tuple[int, bytes]] = OrderedDict()

    def following(self, level: int, first: int, most: int) -> tuple[int, bytes] | None:
        """Return the number of the next bin, and a frame with up to `most` bins before it, from `first` on.

        Return None if there are no such bins. The header's "gap" is the number of bins from `first` on that are no
        longer kept.
        """
        stop = min(self._bins.newest(level), max(first, self._bins.oldest(level)) + most)
        if stop <= first:
            return None
        key = (level, first, stop)
        if key not in self._cache:
            span = self._bins.read(level, first, stop)
            encoded = self._frame(level, span, {"gap": span.first - first})
            self._cache[key] = span.first + len(span), encoded  # the frame is several times smaller than the span
            while len(self._cache) > _CACHED:
                self._cache.popitem(last=False)
        return self._cache[key]

    def past(self, level: int, first: int, count: int, answers: int) -> bytes:
        """Return a frame with those of `count` bins from `first` on that are kept; it answers message `answers`."""
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
    """Return the middle of each channel's range, (m,), from minima and maxima (n, 2, m); 0 without values."""
    least = np.fmin.reduce(low, axis=(0, 1), initial=np.inf)
    most = np.fmax.reduce(high, axis=(0, 1), initial=-np.inf)
    has_values = least <= most
    return np.where(has_values, np.where(has_values, least, 0.0) / 2 + np.where(has_values, most, 0.0) / 2, 0.0)


def _near(values: Floats, offset: Floats) -> np.ndarray[Any, np.dtype[np.float32]]:
    return (values - offset).astype(np.float32)
