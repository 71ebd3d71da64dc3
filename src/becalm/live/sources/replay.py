"""A recording given as if it came now: at its own speed, at a multiple of it, or as fast as it goes."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from becalm.core.arrays import Floats
from becalm.errors import InputError, UsageError
from becalm.files.opening import OpenSource, open_source
from becalm.files.read_options import ReadOptions
from becalm.files.registry import BAG
from becalm.live.address import Address, advising_addresses
from becalm.live.block import Block
from becalm.live.position import told_by
from becalm.live.protocols import EndOfStream

_OPTIONS = ("speed", "rows", "group", "rate", "time", "channels", "stamps")
_BLOCK_ROWS = 1000
_BLOCK_S = 0.01  # where the file's own pace is kept
_CHUNK_ROWS = 1 << 16  # about so many are read at once, and given in blocks
_HEAD_BYTES = 1 << 16
AS_FAST_AS_IT_GOES = float("inf")


class _Rows(NamedTuple):
    """Rows that were read, and not given yet."""

    first: int
    time_s: Floats
    values: Floats
    elapsed: Floats


class ReplaySource:
    """Any file that becalm reads, from any of its rows on.

    Parameters
    ----------
    address : Address
        `replay:FILE?speed=10&rows=1000&group=NAME&rate=100&time=COLUMN&channels=a,b&stamps=as-written`. `speed` is in
        seconds of the recording a second, or "max", for as fast as it goes; `rows` counts those of each block but the
        last, by default 1000, or what 10 ms hold where the pace is kept; the rest is as for `becalm clean`.

    Attributes
    ----------
    names, units : tuple of str
        The channels, once it is open.
    rate_hz : float or None
        Rows a second, once it is open.
    step_s : float or None
        One step of the file's clock, once it is open; what `Block.elapsed` counts.

    Raises
    ------
    UsageError
        If an option is not known or not possible.
    """

    replays = True

    def __init__(self, address: Address) -> None:
        address.refuse_unknown(_OPTIONS)
        if not address.rest:
            raise UsageError("replay: names no file; write replay:FILE.")
        self._path, self._options = Path(address.rest), _read_options(address)
        told = address.options.get("speed", "max")
        self._speed = AS_FAST_AS_IT_GOES if told == "max" else address.number("speed", 1.0, least=1e-6)
        self._block_rows = self._asked_rows = int(address.number("rows", 0, least=1, greatest=1e7))
        self._file: OpenSource | None = None
        self._chunks: Iterator[_Rows] = iter(())
        self._rows: _Rows | None = None
        self._at = 0  # in self._rows
        self._started: tuple[float, float] | None = None  # time.monotonic(), and the file's
        self._print: dict[str, int | str] = {}
        self.names: tuple[str, ...] = ()
        self.units: tuple[str, ...] = ()
        self.rate_hz: float | None = None
        self.step_s: float | None = None

    def open(self, position: str) -> None:
        """Open the file, and go on after `position`.

        Raises
        ------
        InputError
            If the file cannot be read, or is not the one that `position` was told of.
        """
        self.close()
        self._print = _fingerprint(self._path)
        first = self._row_after(position)
        with advising_addresses():
            file = self._file = open_source(self._path, self._options)
        self.names, self.units = file.names, file.units
        self.rate_hz, self.step_s = file.rate_hz, file.clock.step_s
        self._block_rows = self._asked_rows or _fitting_rows(file.rate_hz, self._speed)
        self._chunks, self._rows, self._started = _read(file, first, self._block_rows), None, None

    def read(self, timeout_s: float) -> Block | None:
        """Return the next block, once its last row would have come; None if that is not within `timeout_s`.

        Raises
        ------
        EndOfStream
            After the last row.
        """
        rows = self._rows
        if rows is None or self._at == len(rows.time_s):
            rows = self._rows = next(self._chunks, None)
            self._at = 0
        if rows is None:
            raise EndOfStream
        stop = min(self._at + self._block_rows, len(rows.time_s))
        if not self._has_come(float(rows.time_s[self._at]), float(rows.time_s[stop - 1]), timeout_s):
            return None
        some = slice(self._at, stop)
        self._at = stop
        position = json.dumps({"row": rows.first + stop, **self._print})
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
        """Do nothing: a file need not hear it."""

    def close(self) -> None:
        """Close the file."""
        self._chunks, self._rows = iter(()), None
        if self._file is not None:
            self._file.close()
            self._file = None

    def _has_come(self, first_s: float, last_s: float, timeout_s: float) -> bool:
        """Wait until a row of the file would have come."""
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
        told = told_by("replay", position, "row")
        if not told:
            return 0
        row = int(told.pop("row"))
        if told != self._print:
            raise InputError(
                f"{self._path} is not the file that the stream stopped in: it changed since, or is another one."
                " Put the old one back, or begin a new stream by naming another sink."
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
    """Tell a file from others: by its size, and a hash of its first and last bytes."""
    whole = path / BAG if path.is_dir() else path
    if whole.exists() and not whole.is_file():
        raise InputError(f"{path} cannot be read again, as a replay must be; give what comes from a pipe to stdin:.")
    try:
        with whole.open("rb") as file:
            size = whole.stat().st_size
            ends = hashlib.sha256(file.read(_HEAD_BYTES))
            file.seek(max(0, size - _HEAD_BYTES))
            ends.update(file.read(_HEAD_BYTES))
    except OSError as cause:
        raise InputError(f"{path} cannot be read: {cause.strerror or cause}.") from cause
    return {"size": size, "ends": ends.hexdigest()[:16]}
