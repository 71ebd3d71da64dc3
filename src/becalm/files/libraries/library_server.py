"""Serve the tables of one file at a time from a subprocess; `library_process` starts it and describes the protocol."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import pyarrow as pa

from becalm.errors import BecalmError
from becalm.files.library_reader import file_bytes
from becalm.files.source import RawTable

_BASE_MEMORY_BYTES = 2 << 30  # limit of memory for an empty file
_MEMORY_PER_FILE_BYTE = 64  # more bytes for each byte of the file: data may be compressed, and copied several times
_LONGEST_S, _LEAST_BYTES_PER_S = 3600.0, 1e5  # limit of CPU time, and 1 s more for so many bytes of the file


class _ReadPass(NamedTuple):
    """A pass over rows: the next expected request, later blocks, and the block for that request, if already read."""

    request: dict[str, Any]
    blocks: Iterator[pa.Table]
    block: pa.Table | None


class _Server:
    """A server that answers requests about one file at a time."""

    def __init__(self, answers: BinaryIO) -> None:
        self._answers = answers
        self._path = ""
        self._tables: tuple[RawTable, ...] = ()
        self._prefetched: _ReadPass | None = None

    def answer(self, request: dict[str, Any]) -> None:
        """Answer a request: open a file, or read rows of a table; an empty request closes the file."""
        try:
            if not request:
                self._close()
                self._send({})
            elif "module" in request:
                self._send({"tables": [_table_header(table) for table in self._open(request)]})
            else:
                self._send_rows(self._rows(request))
                self._prefetch()
        except BecalmError as cause:
            self._send({"error": type(cause).__name__, "says": str(cause)})
        except MemoryError:
            says = f"{self._path} needs too much memory; it is damaged or malicious. Copy or download it again."
            self._send({"error": "InputError", "says": says})
        except Exception as cause:  # for example, the working folder was removed
            says = (
                f"{self._path} cannot be read ({type(cause).__name__}: {cause}); give its whole path, or copy it again."
            )
            self._send({"error": "InputError", "says": says})

    def _close(self) -> None:
        for table in self._tables:
            table.rows.close()
        self._tables, self._prefetched = (), None
        os.chdir(os.sep)  # so that other programs can remove the folder

    def _open(self, request: Mapping[str, Any]) -> tuple[RawTable, ...]:
        self._close()
        self._path = request["path"]
        if request["folder"]:
            os.chdir(request["folder"])
        _set_limits(Path(self._path))
        self._tables = import_module(request["module"]).read(Path(self._path))
        return self._tables

    def _rows(self, request: dict[str, Any]) -> pa.Table | None:
        """Return the requested rows, None after the last; consecutive requests share one pass over the file."""
        prefetched, self._prefetched = self._prefetched, None
        if prefetched is None or prefetched.request != request:
            rows = self._tables[request["table"]].rows
            blocks = rows.blocks(request["names"], request["most"], request["start"])
            prefetched = _ReadPass(request, blocks, next(blocks, None))
        if prefetched.block is not None:
            start = request["start"] + prefetched.block.num_rows
            self._prefetched = prefetched._replace(request=request | {"start": start}, block=None)
        return prefetched.block

    def _prefetch(self) -> None:
        """Read the next block before it is requested, while the parent process uses the previous one."""
        prefetched, self._prefetched = self._prefetched, None
        if prefetched is not None:
            with suppress(Exception):  # the request for this block will read again, and report the error
                self._prefetched = prefetched._replace(block=next(prefetched.blocks, None))

    def _send(self, answer: Mapping[str, Any]) -> None:
        self._answers.write(json.dumps(answer).encode() + b"\n")
        self._answers.flush()

    def _send_rows(self, block: pa.Table | None) -> None:
        self._send({"rows": None if block is None else True})
        if block is not None:
            with pa.ipc.new_stream(self._answers, block.schema) as stream:
                stream.write_table(block)
            self._answers.flush()


def _table_header(table: RawTable) -> dict[str, Any]:
    return {
        "schema": table.rows.schema.serialize().to_pybytes().hex(),
        "rows": table.rows.count,
        "count": table.count,
        "format": table.format,
        "units": table.units,
        "group": table.group,
        "time": table.time,
        "notes": table.notes,
    }


def _set_limits(path: Path) -> None:
    """Limit memory and time of this process by the size of a file, if the system supports limits.

    The time limit is longer than the parent process waits; it ends a process that hangs after its parent has ended.
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    size = file_bytes(path)
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    most_bytes = _BASE_MEMORY_BYTES + size + min(_MEMORY_PER_FILE_BYTE * size, machine)
    until_s = time.process_time() + _LONGEST_S + size / _LEAST_BYTES_PER_S
    for what, limit in ((resource.RLIMIT_AS, most_bytes), (resource.RLIMIT_CPU, int(until_s))):
        _, hard = resource.getrlimit(what)
        resource.setrlimit(what, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def main() -> None:
    """Answer requests until there are no more; what a library prints goes to stderr, so that answers stay intact."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # only the parent process ends this process
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    server = _Server(answers)
    for line in sys.stdin.buffer:
        server.answer(json.loads(line))


if __name__ == "__main__":
    main()
