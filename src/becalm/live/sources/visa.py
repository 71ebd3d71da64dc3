"""Read a measuring instrument on GPIB, USB, LAN or a serial port, by queries or by listening."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from typing import Any

import numpy as np

from becalm.errors import UsageError
from becalm.files.text.csv_header import unique_names
from becalm.files.units.unit_spelling import parse_header
from becalm.live.address import Address
from becalm.live.block import Block, Loss, LossKind
from becalm.live.lines.cells import number_of
from becalm.live.optional_libraries import import_optional
from becalm.live.protocols import AwayError

_OPTIONS = ("query", "interval", "columns", "setup", "backend", "timeout", "end")
_ENDS = {"lf": "\n", "cr": "\r", "crlf": "\r\n", "none": ""}
_MOST_SILENCES = 3  # consecutive queries without an answer after which the instrument is away
_NO_READING = 9.9e37  # SCPI's values for overrange and not-a-number are at least this large


class VisaSource:
    """A source that reads an instrument with text answers, such as a voltmeter; the stamp is the arrival time.

    An answer is one row: one number, or several separated by commas. A query without an answer is counted as a missing
    row, and an answer that is not a row of numbers as garbled; SCPI's value for overrange becomes a missing reading.
    After three consecutive queries without an answer, or an error of the bus, the instrument is away.

    Parameters
    ----------
    address : Address
        `visa:GPIB0::7::INSTR?query=READ?&interval=100ms&columns=bridge (V)&setup=*RST&backend=@py&timeout=3s&end=lf`.
        `query` is sent for each row, `READ?` by default; an empty `query=` is for an instrument that sends by itself.
        `interval` is the time between two queries, by default 0; `setup` is sent once at each opening;
        `backend` selects PyVISA's library: @ivi is the vendor's, @py is pyvisa-py, FILE@sim is pyvisa-sim.
        `timeout` is the longest wait for an answer; `end` is the line end: lf, cr, crlf or none.

    Raises
    ------
    UsageError
        If an option is unknown, or its value is not possible.
    """

    replays = False
    rate_hz: float | None = None

    def __init__(self, address: Address) -> None:
        address.refuse_unknown(_OPTIONS)
        if not address.rest:
            raise UsageError("visa: names no instrument; write visa:GPIB0::7::INSTR, or another VISA resource.")
        self._resource, self._options = address.rest, address.options
        self._query = address.options.get("query", "READ?")
        self._interval_s = address.seconds("interval", 0.0)
        if self._interval_s and not self._query:
            raise UsageError("visa: an empty query= listens, but interval= is for queries; give only one of them.")
        self._end = _ENDS[address.chosen("end", tuple(_ENDS), "lf")]
        self._wait_s = address.seconds("timeout", 3.0)
        names = address.names("columns")
        self._names = tuple(unique_names(names))
        self._manager: Any = None
        self._instrument: Any = None
        self._due_s = -math.inf  # time.monotonic() of the next query
        self._silences = 0

    def open(self, position: str) -> None:
        """Connect to the instrument, and set it up.

        Raises
        ------
        AwayError
            If the instrument cannot be reached now.
        UsageError
            If there is no VISA library, or the instrument does not answer in text.
        """
        self.close()
        pyvisa = _pyvisa()
        try:
            self._manager = pyvisa.ResourceManager(self._options.get("backend", ""))
        except (OSError, ValueError) as cause:
            why = str(cause).partition(" 'Traceback")[0].strip()
            raise UsageError(f"visa: finds no VISA library: {why}. Choose one, for example backend=@py.") from cause
        try:
            self._instrument = self._manager.open_resource(self._resource)
            if not isinstance(self._instrument, pyvisa.resources.MessageBasedResource):
                raise UsageError(f"visa: {self._resource} is not an instrument that answers in text.")
            self._instrument.timeout = 1000 * self._wait_s
            self._instrument.read_termination = self._instrument.write_termination = self._end or None
            if setup := self._options.get("setup"):
                self._instrument.write(setup)
        except (pyvisa.errors.Error, OSError, ValueError) as cause:
            raise AwayError(f"The instrument {self._resource} cannot be reached: {cause}.") from cause
        self._silences, self._due_s = 0, -math.inf

    def read(self, timeout_s: float) -> Block | None:
        """Return the next row; None if the next query is not due within `timeout_s`.

        Once a query is sent, this waits for the answer up to the address's `timeout`, even beyond `timeout_s`.

        Raises
        ------
        AwayError
            If the instrument can no longer be reached.
        """
        left_s = self._due_s - time.monotonic()
        if left_s > 0:
            time.sleep(min(left_s, timeout_s))
        if left_s > timeout_s:
            return None
        now_s = time.monotonic()
        on_time = self._due_s + self._interval_s > now_s
        self._due_s = (self._due_s if on_time else now_s) + self._interval_s  # missed queries are not made up for
        answer = self._answer()
        if answer is not None:
            self._silences = 0
            return self._row(answer)
        if not self._query:
            return None
        self._silences += 1
        if self._silences >= _MOST_SILENCES:
            raise AwayError(f"The instrument {self._resource} did not answer {_MOST_SILENCES} times in a row.")
        message = f"The instrument did not answer {self._query!r} within {self._wait_s:g} s."
        return self._losses(Loss(LossKind.MISSING, 1, message))

    def committed(self, position: str) -> None:
        """Do nothing: an instrument needs no acknowledgement."""

    def close(self) -> None:
        """Close the connection to the instrument."""
        resources, self._instrument, self._manager = (self._instrument, self._manager), None, None
        for resource in resources:
            if resource is not None:
                with suppress(Exception):  # an unreachable instrument may raise any error
                    resource.close()

    def _answer(self) -> str | None:
        """Send the query, and return the answer; None after a timeout."""
        pyvisa = _pyvisa()
        if self._instrument is None:
            raise AwayError(f"The instrument {self._resource} is closed.")
        try:
            if self._query:
                self._instrument.write(self._query)
            answer: str = self._instrument.read()
        except UnicodeDecodeError as cause:
            return repr(cause.object)
        except (pyvisa.errors.Error, OSError) as cause:
            if getattr(cause, "error_code", None) != pyvisa.constants.StatusCode.error_timeout:
                raise AwayError(f"The instrument {self._resource} can no longer be reached: {cause}.") from cause
            with suppress(Exception):  # drop a late answer to this query; not every bus can
                self._instrument.clear()
            return None
        return answer

    def _row(self, answer: str) -> Block:
        received_s = time.time()
        numbers = [number_of(cell) for cell in answer.split(",")]
        values = [math.nan if value is None or abs(value) >= _NO_READING else value for value in numbers]
        names = self._names or tuple(unique_names(["value"] * len(numbers)))
        if None in numbers or len(numbers) != len(names):
            message = f"The instrument answered {answer[:60]!r}, not {_expected(self._names)}."
            return self._losses(Loss(LossKind.GARBLED, 1, message))
        self._names = names
        return Block(names, self._units, np.array([received_s]), np.array([values]), arrived_s=time.monotonic())

    def _losses(self, *losses: Loss) -> Block:
        width = len(self._names)
        return Block(self._names, self._units, np.empty(0), np.empty((0, width)), losses=losses)

    @property
    def _units(self) -> tuple[str, ...]:
        return tuple(parse_header(name)[1] for name in self._names)


def _expected(names: tuple[str, ...]) -> str:
    return "a number" if len(names) < 2 else f"{len(names)} numbers separated by commas"


def _pyvisa() -> Any:
    return import_optional("visa:", "pyvisa", "PyVISA")
