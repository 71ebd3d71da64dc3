"""Write the estimates as lines of text to standard output, for another program or a person."""

from __future__ import annotations

import csv
import io
import json
import os
import select
import sys

import numpy as np
import pyarrow as pa

from becalm.errors import OutputError, UsageError
from becalm.files.roles import SIGMA
from becalm.live.address import Address
from becalm.live.block import Head, Output

_TIME = "time"
_UNKNOWN_IN_CSV = {"nan": ""}
_UNKNOWN_IN_JSON = dict.fromkeys(("nan", "inf", "-inf"), "null")


class StdoutSink:
    """A sink for CSV with a header line, or one JSON object per row: time in seconds, and each channel's signal, sigma.

    Each number has the fewest digits that restore it exactly; an unknown number is an empty cell, or null. Rows are
    not buffered: they are written when `write` returns.

    Parameters
    ----------
    address : Address
        `stdout:?format=csv`, or json.
    descriptor : int
        File descriptor to write to, by default standard output.

    Raises
    ------
    UsageError
        If an option is unknown, or its value is not possible.
    """

    def __init__(self, address: Address, descriptor: int = 1) -> None:
        address.refuse_unknown(("format",))
        if address.rest:
            raise UsageError(
                f"stdout: takes no name, but {address.rest!r} was given; write stdout: alone, or parquet:FOLDER."
            )
        self._json = address.chosen("format", ("csv", "json"), "csv") == "json"
        self._unknown = _UNKNOWN_IN_JSON if self._json else _UNKNOWN_IN_CSV
        self._descriptor = descriptor
        self._row_format = ""  # format of a line, with a %s for each number; "" before `open`

    def open(self, head: Head) -> None:
        """Write the CSV header, at the first call only.

        Raises
        ------
        OutputError
            If the header cannot be written, or standard output is closed (another file may then have its descriptor).
        """
        if self._descriptor == 1 and sys.__stdout__ is None:
            raise OutputError(
                "Standard output is closed; connect it to a program or a file, or leave out --sink stdout:."
            )
        if self._row_format:
            return
        names = [_TIME, *(name + end for name in head.names for end in ("", SIGMA))]
        if self._json:
            keys = (json.dumps(name, ensure_ascii=False).replace("%", "%%") for name in names)
            self._row_format = "{" + ", ".join(f"{key}: %s" for key in keys) + "}\n"
            return
        self._row_format = ",".join(["%s"] * len(names)) + "\n"
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(names)
        self._write(text.getvalue())

    def write(self, output: Output) -> None:
        """Write rows.

        Raises
        ------
        OutputError
            If they cannot be written, for example because the reading program has ended.
        """
        if not len(output):
            return
        numbers = np.empty((len(output), 1 + 2 * output.signal.shape[1]))
        numbers[:, 0], numbers[:, 1::2], numbers[:, 2::2] = output.time_s, output.signal, output.sigma
        texts = pa.array(numbers.ravel()).cast(pa.string()).to_pylist()  # four times as fast as Python's own repr
        if not np.isfinite(numbers).all():
            texts = [self._unknown.get(text, text) for text in texts]
        width = numbers.shape[1]
        self._write("".join([self._row_format % (*texts[at : at + width],) for at in range(0, len(texts), width)]))

    def flush(self) -> None:
        """Do nothing: rows are not buffered."""

    def close(self) -> None:
        """Do nothing: standard output was opened by the parent process."""

    def _write(self, text: str) -> None:
        left = memoryview(text.encode("utf-8", "surrogateescape"))
        while left:
            try:
                left = left[os.write(self._descriptor, left) :]
            except BlockingIOError:  # another process that shares the descriptor has made it non-blocking
                select.select([], [self._descriptor], [])
            except BrokenPipeError as cause:
                raise OutputError(
                    "The program that read standard output has ended; no more is written to it."
                ) from cause
            except OSError as cause:
                raise OutputError(f"Standard output cannot be written: {cause.strerror or cause}.") from cause
