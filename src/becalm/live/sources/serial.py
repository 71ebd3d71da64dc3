"""Lines from a serial port."""

from __future__ import annotations

import errno
from typing import Any

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Block
from becalm.live.optional_libraries import wanted
from becalm.live.protocols import AwayError
from becalm.live.sources.lined import LineSource

_OPTIONS = ("baud", "bytes", "parity", "stop", "flow")
_PARITIES = {"none": "N", "even": "E", "odd": "O"}
_NAP_S = 0.05  # the longest that one read of the port waits


class SerialSource(LineSource):
    """Lines from a serial port, as `LineSource` tells.

    Whoever opens a port may come in the middle of a line: the first line after each opening is left out and not
    counted, unless nothing is known yet and it holds names only, as of a board that begins anew when it is opened.

    Parameters
    ----------
    address : Address
        `serial:/dev/ttyUSB0?baud=115200&bytes=8&parity=none&stop=1&flow=none`, and the options of lines. In place of
        a port, what pyserial can open: `serial:socket://HOST:PORT`.
    """

    def __init__(self, address: Address) -> None:
        super().__init__(address, _OPTIONS)
        if not address.rest:
            raise UsageError("serial: names no port; write serial:/dev/ttyUSB0, or serial:COM3.")
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
        self._name = address.rest
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
        serial = wanted("serial:", "serial", "pyserial")
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
            return self._rows(timeout_s)
        except OSError as cause:
            raise AwayError(f"The port {self._name} went away: {cause}.") from cause

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
