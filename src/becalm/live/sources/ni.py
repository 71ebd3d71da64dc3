"""Read voltages from a National Instruments device that samples with its own clock."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import Any

import numpy as np

from becalm.core.time.clock import FASTEST_HZ, SLOWEST_HZ
from becalm.errors import UsageError
from becalm.files.text.csv_header import unique_names
from becalm.files.units.unit_conversion import conversion
from becalm.files.units.unit_spelling import parse_header
from becalm.live.address import Address
from becalm.live.block import Block
from becalm.live.optional_libraries import import_optional
from becalm.live.protocols import AwayError

_OPTIONS = ("rate", "range", "wiring", "columns", "rows")
_WIRINGS = {"default": "DEFAULT", "rse": "RSE", "nrse": "NRSE", "diff": "DIFF", "pseudo-diff": "PSEUDO_DIFF"}
_BLOCK_S = 0.01  # default length of a block, in seconds
_BUFFER_S = 10.0  # length of the driver's buffer, in seconds
_LEAST_BUFFER = 10_000  # rows in the driver's buffer
_MOST_ROWS = 1 << 16  # in a block
_BAD_VALUE = -200077  # the driver's error code for a rate or range that the device does not support


class NiSource:
    """A source that reads analogue inputs through NI-DAQmx, sampled continuously at a rate set by the hardware.

    This was written from the documentation of nidaqmx and tested only with a simulated driver, never with a device or
    the vendor's driver.

    The stamps count the device's samples from the moment when it was started. The driver buffers at least ten seconds;
    if the stream falls further behind, the driver stops, the source counts as away, and the device is started again.

    Parameters
    ----------
    address : Address
        `ni:Dev1/ai0:3?rate=1000&range=10&wiring=diff&columns=ax,bridge (mV)&rows=10`. `rate` in hertz is required;
        `range` is the greatest voltage, 10 by default; a name may contain a unit of voltage, to which readings are
        converted; `rows` is the least number of rows in a block, by default as many as are sampled in 10 ms.

    Attributes
    ----------
    rate_hz : float or None
        Sample rate in hertz; once the source is open, the actual rate of the device.

    Raises
    ------
    UsageError
        If an option is unknown, its value is not possible, or the rate is missing.
    """

    replays = False

    def __init__(self, address: Address) -> None:
        address.refuse_unknown(_OPTIONS)
        if not address.rest or "rate" not in address.options:
            raise UsageError("ni: needs channels and a rate in hertz; write ni:Dev1/ai0:3?rate=1000.")
        self._channels, self._column_names = address.rest, address.names("columns")
        self._rate_hz = address.number("rate", 0.0, least=SLOWEST_HZ, greatest=FASTEST_HZ)
        self._range_v = address.number("range", 10.0, least=1e-3, greatest=1e4)
        self._wiring = _WIRINGS[address.chosen("wiring", tuple(_WIRINGS), "default")]
        self._block_rows = int(
            address.number("rows", max(1, round(_BLOCK_S * self._rate_hz)), least=1, greatest=_MOST_ROWS)
        )
        self.rate_hz: float | None = self._rate_hz
        self._names: tuple[str, ...] = ()
        self._units: tuple[str, ...] = ()
        self._factors = np.ones(0)  # from volts
        self._task: Any = None
        self._reader: Any = None
        self._start_s, self._count = 0.0, 0

    def open(self, position: str) -> None:
        """Start the device.

        Raises
        ------
        AwayError
            If the device cannot be reached now.
        UsageError
            If the driver is not installed, or the device does not support the settings.
        """
        self.close()
        nidaqmx = import_optional("ni:", "nidaqmx")
        from nidaqmx import constants, errors
        from nidaqmx.stream_readers import AnalogMultiChannelReader

        try:
            self._task = nidaqmx.Task()
            self._task.ai_channels.add_ai_voltage_chan(
                self._channels,
                terminal_config=constants.TerminalConfiguration[self._wiring],
                min_val=-self._range_v,
                max_val=self._range_v,
            )
            buffer = max(_LEAST_BUFFER, round(_BUFFER_S * self._rate_hz), 2 * self._block_rows)
            self._task.timing.cfg_samp_clk_timing(
                self._rate_hz, sample_mode=constants.AcquisitionType.CONTINUOUS, samps_per_chan=buffer
            )
            self.rate_hz = float(self._task.timing.samp_clk_rate)
            self._set_names(list(self._task.channel_names))
            self._reader = AnalogMultiChannelReader(self._task.in_stream)
            self._task.start()
        except (errors.DaqNotFoundError, errors.DaqNotSupportedError) as cause:
            raise UsageError(
                "ni: needs the vendor's driver, which is not installed; get NI-DAQmx from ni.com."
            ) from cause
        except errors.Error as cause:
            if getattr(cause, "error_code", None) == _BAD_VALUE:
                raise UsageError(
                    f"ni: {self._channels} does not support these settings: {_first_line(cause)}"
                ) from cause
            raise AwayError(f"The device of {self._channels} cannot be reached: {_first_line(cause)}") from cause
        self._start_s, self._count = time.time(), 0

    def read(self, timeout_s: float) -> Block | None:
        """Return the rows in the buffer; None if there are fewer than a block after `timeout_s`, see `_wait`.

        Raises
        ------
        AwayError
            If the device was disconnected, or was read too slowly.
        """
        if self._task is None:
            raise AwayError(f"The device of {self._channels} is closed.")
        from nidaqmx import errors

        try:
            ready = self._wait(timeout_s)
            if not ready:
                return None
            data = np.empty((len(self._names), ready))
            self._reader.read_many_sample(data, ready, timeout=_BUFFER_S)
        except errors.Error as cause:
            raise AwayError(f"The device of {self._channels} stopped: {_first_line(cause)}") from cause
        rate_hz = self.rate_hz or self._rate_hz
        time_s = self._start_s + np.arange(self._count, self._count + ready) / rate_hz
        self._count += ready
        return Block(
            self._names, self._units, time_s, np.ascontiguousarray(data.T) * self._factors, arrived_s=time.monotonic()
        )

    def committed(self, position: str) -> None:
        """Do nothing: a device needs no acknowledgement."""

    def close(self) -> None:
        """Stop the device."""
        task, self._task, self._reader = self._task, None, None
        if task is not None:
            with suppress(Exception):  # an unplugged device may raise any error
                task.close()

    def _wait(self, timeout_s: float) -> int:
        """Return the number of rows that can be read; 0 if they are fewer than a block after `timeout_s`.

        A timeout of 0 is the last call before the end: all rows count then, even fewer than a block.
        """
        until = time.monotonic() + timeout_s
        while (ready := int(self._task.in_stream.avail_samp_per_chan)) < self._block_rows:
            left_s = until - time.monotonic()
            if left_s <= 0:
                return 0 if timeout_s > 0 else ready
            time.sleep(min(left_s, max(1e-3, self._block_rows / self._rate_hz / 4)))
        return min(ready, _MOST_ROWS)

    def _set_names(self, channels: list[str]) -> None:
        """Set names, units and factors: names from the option, or the device's channel names, such as ai0."""
        names = self._column_names or tuple(channel.rpartition("/")[2] for channel in channels)
        if len(names) != len(channels):
            raise UsageError(
                f"ni: {self._channels} has {len(channels)} channels, but the number of names in columns= is"
                f" {len(names)}; give a name for each channel."
            )
        self._names = tuple(unique_names(names))
        self._units = tuple(parse_header(name)[1] or "V" for name in names)
        self._factors = np.array([conversion("V", unit).factor for unit in self._units])


def _first_line(cause: Exception) -> str:
    return str(cause).strip().partition("\n")[0]
