"""Rows as PostgreSQL's binary COPY takes them: each cell its length, then its big-endian bytes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from becalm.live.block import Output

BEGINS = b"PGCOPY\n\xff\r\n\0" + bytes(8)
"""What comes before the first row: the signature, no flags, no extension."""
ENDS = b"\xff\xff"
"""What comes after the last row."""

_MOST_BYTES = 1 << 18  # of one piece: it stays in the cache between being made and being sent


class BinaryRows:
    """Makes the bytes of rows: row, time_s, for each channel clean, raw and sigma, then all verdicts.

    Parameters
    ----------
    channels : int
        How many, m.
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

    def of(self, output: Output) -> Iterator[memoryview]:
        """Return the rows of an output, piece by piece; each piece lasts until the next is asked for."""
        for first in range(0, len(output), len(self._piece)):
            some = slice(first, min(first + len(self._piece), len(output)))
            piece = self._piece[: some.stop - some.start]
            piece["row"]["value"] = np.arange(output.first_row + some.start, output.first_row + some.stop)
            piece["time"]["value"] = output.time_s[some]
            for place, values in enumerate((output.signal, output.values, output.sigma)):
                piece["floats"]["value"][:, :, place] = values[some]
            piece["verdicts"]["value"] = output.verdicts[some]
            yield piece.view(np.uint8).data


def _cell(kind: str) -> np.dtype[np.void]:
    return np.dtype([("length", ">i4"), ("value", kind)])
