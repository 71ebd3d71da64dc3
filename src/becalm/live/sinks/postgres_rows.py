"""Encode rows for PostgreSQL's binary COPY: for each cell its length, then its big-endian bytes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from becalm.live.block import Output

COPY_HEADER = b"PGCOPY\n\xff\r\n\0" + bytes(8)
"""Bytes before the first row: the signature, no flags, no extension."""
COPY_TRAILER = b"\xff\xff"
"""Bytes after the last row."""

_MOST_BYTES = 1 << 18  # of one piece, so that it stays in the processor's cache until it is sent


class BinaryRows:
    """An encoder of rows: row, time_s, for each channel clean, raw and sigma, then all verdicts.

    Parameters
    ----------
    channels : int
        Number of channels, m.
    """

    def __init__(self, channels: int) -> None:
        number, code = _cell(">f8"), _cell(">i2")
        self._layout = np.dtype(
            [
                ("cells", ">i2"),
                ("row", _cell(">i8")),
                ("time", number),
                ("floats", number, (channels, 3)),
                ("verdicts", code, (channels,)),
            ]
        )
        most = max(_MOST_BYTES // self._layout.itemsize, 1)
        self._piece = np.zeros(most, self._layout)
        self._piece["cells"] = 2 + 4 * channels
        for name in ("row", "time", "floats", "verdicts"):
            self._piece[name]["length"] = self._layout[name].base["value"].itemsize

    def encode(self, output: Output) -> Iterator[memoryview]:
        """Yield the encoded rows of an output in pieces; each piece is valid until the next one is taken."""
        for first in range(0, len(output), len(self._piece)):
            rows = slice(first, min(first + len(self._piece), len(output)))
            piece = self._piece[: rows.stop - rows.start]
            piece["row"]["value"] = np.arange(output.first_row + rows.start, output.first_row + rows.stop)
            piece["time"]["value"] = output.time_s[rows]
            for place, values in enumerate((output.signal, output.values, output.sigma)):
                piece["floats"]["value"][:, :, place] = values[rows]
            piece["verdicts"]["value"] = output.verdicts[rows]
            yield piece.view(np.uint8).data


def _cell(kind: str) -> np.dtype[np.void]:
    return np.dtype([("length", ">i4"), ("value", kind)])
