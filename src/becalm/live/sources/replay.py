"""Replay a recording as a live stream: at its own speed, at a multiple of it, or as fast as possible."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from becalm.core.arrays import Floats
from becalm.errors import InputError, UsageError
from becalm.files.inputs.opening import OpenSource, open_source
from becalm.files.read_options import ReadOptions
from becalm.files.registry import BAG
from becalm.live.address import Address, advising_addresses
from becalm.live.block import Block
from becalm.live.position import parse_position
from becalm.live.protocols import EndOfStream

_OPTIONS = ("speed", "rows", "group", "rate", "time", "channels", "stamps")
_BLOCK_ROWS = 1000  # most rows in a block by default
_BLOCK_S = 0.01  # length of a block if the speed is limited
_CHUNK_ROWS = 1 << 16  # approximate number of rows read at once, and returned in blocks
_END_BYTES = 1 << 16  # bytes at each end of the file that identify it
AS_FAST_AS_IT_GOES = float("inf")


class _Rows(NamedTuple):
    """A chunk of rows that was read from the file."""

    first: int
    time_s: Floats
    values: Floats
    elapsed: Floats


class ReplaySource:
    """A source that replays any file becalm can read, from any of its rows.

    Parameters
    ----------
    address : Address
        `replay:FILE?speed=10&rows=1000&group=NAME&rate=100&time=COLUMN&channels=a,b&stamps=as-written`. `speed` is in
        seconds of the recording per second, or "max" for as fast as possible; `rows` is the number of rows in each
        block except the last, by default 1000, or as many as are due in 10 ms if the speed is limited; the other
        options are those of `becalm clean`.

    Attributes
    ----------
    names, units : tuple of str
        Names and units of the channels, once the source is open.
    rate_hz : float or None
        Sample rate in hertz, once the source is open.
    step_s : float or None
        Step of the file's clock in seconds, once the source is open; `Block.elapsed` counts these steps.

    Raises
    ------
    UsageError
        If an option is unknown, or its value is not possible.
    """

    replays = True

    def __init__(self, address: Address) -> None:
        address.refuse_unknown(_OPTIONS)
        if not address.rest:
            raise UsageError("replay: names no file; write replay:FILE.")
        self._path, self._options = Path(address.rest), _read_options(address)
        is_max = address.options.get("speed", "max") == "max"
        self._speed = AS_FAST_AS_IT_GOES if is_max else address.number("speed", 1.0, least=1e-6)
        self._block_rows = self._rows_option = int(address.number("rows", 0, least=1, greatest=1e7))
        self._file: OpenSource | None = None
        self._chunks: Iterator[_Rows] = iter(())
        self._rows: _Rows | None = None
        self._index = 0  # of the next row in self._rows
        self._started: tuple[float, float] | None = None  # time.monotonic() and the file's time at the first row
        self._fingerprint: dict[str, int | str] = {}
        self.names: tuple[str, ...] = ()
        self.units: tuple[str, ...] = ()
        self.rate_hz: float | None = None
        self.step_s: float | None = None

    def open(self, position: str) -> None:
        """Open the file, and continue after `position`.

        Raises
        ------
        InputError
            If the file cannot be read, or `position` belongs to another file.
        """
        self.close()
        self._fingerprint = _fingerprint(self._path)
        first = self._row_after(position)
        with advising_addresses():
            file = self._file = open_source(self._path, self._options)
        self.names, self.units = file.names, file.units
        self.rate_hz, self.step_s = file.rate_hz, file.clock.step_s
        self._block_rows = self._rows_option or _fitting_rows(file.rate_hz, self._speed)
        self._chunks, self._rows, self._started = _read(file, first, self._block_rows), None, None

    def read(self, timeout_s: float) -> Block | None:
        """Return the next block once its last row is due; None if it is not due within `timeout_s`.

        Raises
        ------
        EndOfStream
            After the last row.
        """
        rows = self._rows
        if rows is None or self._index == len(rows.time_s):
            rows = self._rows = next(self._chunks, None)
            self._index = 0
        if rows is None:
            raise EndOfStream
        stop = min(self._index + self._block_rows, len(rows.time_s))
        if not self._is_due(float(rows.time_s[self._index]), float(rows.time_s[stop - 1]), timeout_s):
            return None
        some = slice(self._index, stop)
        self._index = stop
        position = json.dumps({"row": rows.first + stop, **self._fingerprint})
        return Block(
            self.names,
            self.units,
            rows.time_s[some],
            rows.values[some],
            position,
            rows.elapsed[some],
            arrived_s=time.monotonic(),
        )

    def committed(self, position: str) -> None:
        """Do nothing: a file needs no acknowledgement."""

    def close(self) -> None:
        """Close the file."""
        self._chunks, self._rows = iter(()), None
        if self._file is not None:
            self._file.close()
            self._file = None

    def _is_due(self, first_s: float, last_s: float, timeout_s: float) -> bool:
        """Wait until the row at `last_s` is due, at most `timeout_s`; return whether it is due."""
        if self._speed == AS_FAST_AS_IT_GOES:
            return True
        if self._started is None:
            self._started = time.monotonic(), first_s
        began, began_s = self._started
        left_s = began + (last_s - began_s) / self._speed - time.monotonic()
        if left_s > 0:
            time.sleep(min(left_s, timeout_s))
        return left_s <= timeout_s

    def _row_after(self, position: str) -> int:
        fields = parse_position("replay", position, "row")
        if not fields:
            return 0
        row = int(fields.pop("row"))
        if fields != self._fingerprint:
            raise InputError(
                f"{self._path} is not the file that the stream stopped in: it was changed, or it is another file."
                " Restore the old file, or start a new stream with another sink."
            )
        return row


def _read_options(address: Address) -> ReadOptions:
    return ReadOptions(
        time=address.options.get("time"),
        rate_hz=address.number("rate", 0.0) if "rate" in address.options else None,
        channels=address.names("channels") or None,
        group=address.options.get("group"),
        as_written=address.chosen("stamps", ("mended", "as-written"), "mended") == "as-written",
    )


def _read(file: OpenSource, first: int, block_rows: int) -> Iterator[_Rows]:
    whole_blocks = max(1, _CHUNK_ROWS // block_rows) * block_rows
    for chunk in file.chunks(whole_blocks, first):
        yield _Rows(chunk.first_row, file.seconds(chunk.first_row, len(chunk)), chunk.samples, chunk.elapsed_steps)


def _fitting_rows(rate_hz: float, speed: float) -> int:
    if speed == AS_FAST_AS_IT_GOES:
        return _BLOCK_ROWS
    return max(1, min(_BLOCK_ROWS, round(_BLOCK_S * rate_hz * speed)))


def _fingerprint(path: Path) -> dict[str, int | str]:
    """Return the size of a file and a hash of its first and last bytes, which identify it."""
    file_path = path / BAG if path.is_dir() else path
    if file_path.exists() and not file_path.is_file():
        raise InputError(f"{path} is not a file, so it cannot be replayed; to read from a pipe, use stdin:.")
    try:
        with file_path.open("rb") as file:
            size = file_path.stat().st_size
            ends = hashlib.sha256(file.read(_END_BYTES))
            file.seek(max(0, size - _END_BYTES))
            ends.update(file.read(_END_BYTES))
    except OSError as cause:
        raise InputError(f"{path} cannot be read: {cause.strerror or cause}.") from cause
    return {"size": size, "ends": ends.hexdigest()[:16]}
