"""Lines from a serial port."""

from __future__ import annotations

import errno
from types import ModuleType
from typing import Any

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Block
from becalm.live.lines.columns import LineOptions
from becalm.live.lines.feeding import Lines
from becalm.live.protocols import AwayError
from becalm.live.sources.lined import read_lines

_OPTIONS = ("baud", "bytes", "parity", "stop", "flow", *LineOptions.NAMES)
_PARITIES = {"none": "N", "even": "E", "odd": "O"}
_NAP_S = 0.05  # the longest that one read of the port waits


class SerialSource:
    """CSV or JSON lines from a serial port; what comes while nobody reads is gone.

    Whoever opens a port may come in the middle of a line: the first line after each opening is left out and not
    counted, unless nothing is known yet and it holds names only, as of a board that begins anew when it is opened.

    Parameters
    ----------
    address : Address
        `serial:/dev/ttyUSB0?baud=115200&bytes=8&parity=none&stop=1&flow=none`, and the options of lines: `format`,
        `columns`, `time`, `rate`, `channels`. In place of a port, what pyserial can open: `serial:socket://HOST:PORT`.

    Attributes
    ----------
    rate_hz : float or None
        Rows a second, where it was told.

    Raises
    ------
    UsageError
        If an option is not known or not possible.
    """

    replays = False

    def __init__(self, address: Address) -> None:
        address.refuse_unknown(_OPTIONS)
        if not address.rest:
            raise UsageError("serial: names no port; write serial:/dev/ttyUSB0, or serial:COM3.")
        options = LineOptions.of(address)
        flow = address.chosen("flow", ("none", "rtscts", "xonxoff"), "none")
        self._settings = {
            "baudrate": int(address.number("baud", 115_200, least=50, greatest=2e7)),
            "bytesize": int(address.chosen("bytes", ("7", "8"), "8")),
            "parity": _PARITIES[address.chosen("parity", tuple(_PARITIES), "none")],
            "stopbits": int(address.chosen("stop", ("1", "2"), "1")),
            "rtscts": flow == "rtscts",
            "xonxoff": flow == "xonxoff",
            "timeout": _NAP_S,
            "exclusive": True,
        }
        self.rate_hz = options.rate_hz
        self._name, self._lines = address.rest, Lines(options)
        self._port: Any = None

    def open(self, position: str) -> None:
        """Open the port.

        Raises
        ------
        AwayError
            If it is not there, or another program has it.
        BecalmError
            If it can never be opened so.
        """
        self.close()
        serial = _pyserial()
        try:
            self._port = serial.serial_for_url(self._name, **self._settings)
        except ValueError as cause:  # no such speed, no such kind of URL
            raise UsageError(f"serial: {self._name} cannot be opened so: {cause}.") from cause
        except OSError as cause:  # pyserial's own error is one
            if cause.errno in (errno.EACCES, errno.EPERM):
                raise InputError(
                    f"The port {self._name} may not be opened by you; on Linux, type: sudo usermod -aG dialout $USER,"
                    " and log in again."
                ) from cause
            raise AwayError(f"The port {self._name} cannot be opened: {cause}.") from cause
        self._lines.begin_within()

    def read(self, timeout_s: float) -> Block | None:
        """Return the rows that came, or None where none did within `timeout_s`, or 50 ms more.

        Raises
        ------
        AwayError
            If the port was unplugged.
        UsageError
            If what was said of the lines does not fit them.
        """
        try:
            return read_lines(self._lines, self._more, timeout_s)
        except OSError as cause:
            raise AwayError(f"The port {self._name} went away: {cause}.") from cause

    def committed(self, position: str) -> None:
        """Do nothing: a port need not hear it."""

    def close(self) -> None:
        """Close the port."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def _more(self, timeout_s: float) -> bytes | None:
        if self._port is None:
            raise AwayError(f"The port {self._name} is closed.")
        waiting = self._port.in_waiting
        if not waiting and timeout_s <= 0:
            return None
        data: bytes = self._port.read(waiting or 1)
        return data + self._port.read(self._port.in_waiting) if data else None


def _pyserial() -> ModuleType:
    try:
        import serial
    except ImportError as cause:
        raise UsageError("serial: needs pyserial; type: pip install 'becalm[live]'") from cause
    module: ModuleType = serial
    return module
