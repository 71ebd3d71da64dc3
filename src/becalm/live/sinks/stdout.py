"""Clean rows as lines of text, for the next program or a person."""

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
    """CSV with one line of names, or a JSON object a row: time in seconds, then of each channel signal and sigma.

    Each number has the fewest digits that give it back to the bit; what is not known is an empty cell, or null. Rows
    are out when `write` returns: nothing is held back.

    Parameters
    ----------
    address : Address
        `stdout:?format=csv`, or json.
    descriptor : int
        The file descriptor to write to; standard output.

    Raises
    ------
    UsageError
        If an option is not known or not possible.
    """

    def __init__(self, address: Address, descriptor: int = 1) -> None:
        address.refuse_unknown(("format",))
        if address.rest:
            raise UsageError(f"stdout: takes no name, {address.rest!r} came; write stdout: alone, or parquet:FOLDER.")
        self._json = address.chosen("format", ("csv", "json"), "csv") == "json"
        self._unknown = _UNKNOWN_IN_JSON if self._json else _UNKNOWN_IN_CSV
        self._descriptor = descriptor
        self._line = ""  # with a place for each number; "" before anything was written

    def open(self, head: Head) -> None:
        """Write the names, the first time.

        Raises
        ------
        OutputError
            If they cannot be written, or standard output is closed: another file may have its number then.
        """
        if self._descriptor == 1 and sys.__stdout__ is None:
            raise OutputError("Standard output is closed; give it to a program or a file, or leave --sink stdout: out.")
        if self._line:
            return
        names = [_TIME, *(name + end for name in head.names for end in ("", SIGMA))]
        if self._json:
            keys = (json.dumps(name, ensure_ascii=False).replace("%", "%%") for name in names)
            self._line = "{" + ", ".join(f"{key}: %s" for key in keys) + "}\n"
            return
        self._line = ",".join(["%s"] * len(names)) + "\n"
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(names)
        self._write(text.getvalue())

    def write(self, output: Output) -> None:
        """Write some rows.

        Raises
        ------
        OutputError
            If they cannot be written, as where the other program has ended.
        """
        if not len(output):
            return
        numbers = np.empty((len(output), 1 + 2 * output.signal.shape[1]))
        numbers[:, 0], numbers[:, 1::2], numbers[:, 2::2] = output.time_s, output.signal, output.sigma
        texts = pa.array(numbers.ravel()).cast(pa.string()).to_pylist()  # four times as fast as Python's own repr
        if not np.isfinite(numbers).all():
            texts = [self._unknown.get(text, text) for text in texts]
        width = numbers.shape[1]
        self._write("".join([self._line % (*texts[at : at + width],) for at in range(0, len(texts), width)]))

    def flush(self) -> None:
        """Do nothing: all that was written is out."""

    def close(self) -> None:
        """Leave the output open: it is not ours."""

    def _write(self, text: str) -> None:
        left = memoryview(text.encode("utf-8", "surrogateescape"))
        while left:
            try:
                left = left[os.write(self._descriptor, left) :]
            except BlockingIOError:  # it was made so by whoever shares it
                select.select([], [self._descriptor], [])
            except BrokenPipeError as cause:
                raise OutputError(
                    "The program that read standard output has ended; no more is written to it."
                ) from cause
            except OSError as cause:
                raise OutputError(f"Standard output cannot be written: {cause.strerror or cause}.") from cause
