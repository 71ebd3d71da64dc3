"""Read lines from a serial port."""

from __future__ import annotations

import errno
from typing import Any

from becalm.errors import InputError, UsageError
from becalm.live.address import Address
from becalm.live.block import Block
from becalm.live.optional_libraries import import_optional
from becalm.live.protocols import AwayError
from becalm.live.sources.lined import LineSource

_OPTIONS = ("baud", "bytes", "parity", "stop", "flow")
_PARITIES = {"none": "N", "even": "E", "odd": "O"}
_READ_TIMEOUT_S = 0.05  # longest wait of one read from the port


class SerialSource(LineSource):
    """A `LineSource` that reads a serial port.

    The port may be opened in the middle of a line, so the first line after each opening is left out and not counted.
    A first line of names only is used: a board that restarts when its port is opened sends it complete.

    Parameters
    ----------
    address : Address
        `serial:/dev/ttyUSB0?baud=115200&bytes=8&parity=none&stop=1&flow=none`, and the options of `LineSource`.
        The port may also be a URL that pyserial can open: `serial:socket://HOST:PORT`.
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
            "timeout": _READ_TIMEOUT_S,
            "exclusive": True,
        }
        self._name = address.rest
        self._port: Any = None

    def open(self, position: str) -> None:
        """Open the port.

        Raises
        ------
        AwayError
            If the port is absent, or another program uses it.
        BecalmError
            If the port can never be opened with these settings.
        """
        self.close()
        serial = import_optional("serial:", "serial", "pyserial")
        try:
            self._port = serial.serial_for_url(self._name, **self._settings)
        except ValueError as cause:  # an unsupported speed, or an unknown kind of URL
            raise UsageError(f"serial: {self._name} cannot be opened with these settings: {cause}.") from cause
        except OSError as cause:  # the base class of pyserial's own error
            if cause.errno in (errno.EACCES, errno.EPERM):
                raise InputError(
                    f"You have no permission to open the port {self._name}; on Linux, type: sudo usermod -aG dialout"
                    " $USER, and log in again."
                ) from cause
            raise AwayError(f"The port {self._name} cannot be opened: {cause}.") from cause
        self._lines.expect_partial_line()

    def read(self, timeout_s: float) -> Block | None:
        """Return the received rows; None if none arrives within `timeout_s`, or up to 50 ms later.

        Raises
        ------
        AwayError
            If the port was unplugged.
        UsageError
            If the options of the address do not fit the lines.
        """
        try:
            return self._rows(timeout_s)
        except OSError as cause:
            raise AwayError(f"The port {self._name} can no longer be read: {cause}.") from cause

    def close(self) -> None:
        """Close the port."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def _read_bytes(self, timeout_s: float) -> bytes | None:
        if self._port is None:
            raise AwayError(f"The port {self._name} is closed.")
        waiting = self._port.in_waiting
        if not waiting and timeout_s <= 0:
            return None
        data: bytes = self._port.read(waiting or 1)
        return data + self._port.read(self._port.in_waiting) if data else None
