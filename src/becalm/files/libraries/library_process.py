"""Read formats with other libraries in a subprocess, so that a damaged file cannot crash becalm or fill its memory.

A request is a line of JSON. The answer is a line of JSON, followed by an Arrow stream if it has rows. The subprocess is
kept for the next file, because starting it takes longer than reading a small file.
"""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from threading import Event, RLock, Timer
from typing import IO, Any, ClassVar
from weakref import finalize

import pyarrow as pa

from becalm import errors
from becalm.errors import InputError
from becalm.files.library_reader import file_bytes
from becalm.files.source import FormatTime, RawTable, shared_closers
from becalm.installation import MODULE, environment

LONGEST_S, BYTES_PER_S = 60.0, 1e6
"""The time limit of an answer: LONGEST_S seconds, and one more second for each BYTES_PER_S bytes of the file."""

_PIPE_BYTES, _ENDS_WITHIN_S = 1 << 20, 2.0  # buffer size of the pipe for answers; time to close a file, or to end, in s

_FEW_THREADS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}
"""Environment of the subprocess: each thread reserves address space, which counts towards its memory limit."""


def read_in_subprocess(module: str, path: Path) -> tuple[RawTable, ...]:
    """Open the tables of a file in a subprocess, which reads their rows on demand.

    Parameters
    ----------
    module : str
        The module that reads the format: its `read` takes the path and returns the tables.
    path : Path
        The file.

    Raises
    ------
    InputError
        If the file cannot be read, or the subprocess crashes, hangs, or needs too much memory.
    """
    process = _LibraryProcess.take(path)
    folder = "" if path.is_absolute() else str(Path.cwd())
    try:
        answer = process.ask(path, {"module": module, "path": _own_name(path), "folder": folder})
    except BaseException:
        process.put_back()
        raise
    tables = answer["tables"]
    opened = _OpenFile(process, path)
    closers = shared_closers(len(tables), opened.close)
    rows = [
        _SubprocessRows(opened, number, table, close)
        for number, (table, close) in enumerate(zip(tables, closers, strict=True))
    ]
    return tuple(map(_table, rows, tables))


def _own_name(path: Path) -> str:
    """Return a path that leads to the same file in another process; /dev/stdin, for example, does not."""
    return os.path.realpath(path) if path.parts[1:2] in (("dev",), ("proc",)) else str(path)


def _table(rows: _SubprocessRows, table: Mapping[str, Any]) -> RawTable:
    time = None if table["time"] is None else FormatTime(*table["time"])
    return RawTable(
        rows,
        table["count"],
        table["format"],
        table["units"],
        group=table["group"],
        time=time,
        notes=tuple(table["notes"]),
    )


class _SubprocessRows:
    """The rows of a table that a subprocess reads."""

    def __init__(self, opened: _OpenFile, number: int, table: Mapping[str, Any], close: Callable[[], None]) -> None:
        self._opened, self._number, self._close, self.count = opened, number, close, table["rows"]
        self.schema = pa.ipc.read_schema(pa.py_buffer(bytes.fromhex(table["schema"])))

    def blocks(self, names: Sequence[str], most_rows: int, start: int = 0) -> Iterator[pa.Table]:
        """Yield the named columns from row `start` on, in blocks of up to `most_rows`."""
        while start < self.count:
            block = self._opened.rows({"table": self._number, "names": [*names], "most": most_rows, "start": start})
            if block is None:
                return
            yield block
            start += block.num_rows

    def close(self) -> None:
        """Close the table; further calls do nothing."""
        self._close()


class _OpenFile:
    """A file that a subprocess holds open until the last of its tables is closed."""

    def __init__(self, process: _LibraryProcess, path: Path) -> None:
        self._process, self._path = process, path
        self._free = finalize(self, process.put_back)  # runs also if the tables are never closed

    def rows(self, request: Mapping[str, Any]) -> pa.Table | None:
        """Return the requested rows, or None after the last."""
        if not self._free.alive:
            raise InputError(f"{self._path} is closed; open it again.")
        answer: pa.Table | None = self._process.ask(self._path, request)["rows"]
        return answer

    def close(self) -> None:
        """Close the file; the process is then free for another one."""
        self._process.close_file()
        self._free()


class _LibraryProcess:
    """A subprocess that reads one file at a time."""

    _idle: ClassVar[deque[_LibraryProcess]] = deque()  # appending is safe in any thread in which a finalizer runs

    def __init__(self) -> None:
        self._owner = os.getpid()
        self._asking = RLock()
        self._closing = False  # whether the answer to a request to close the file is still pending
        self._process = subprocess.Popen(
            [*MODULE, "becalm.files.libraries.library_server"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment() | _FEW_THREADS,
        )
        _widen(self._process.stdout)

    @classmethod
    def take(cls, path: Path) -> _LibraryProcess:
        """Return an idle process or a new one; after a fork, the child does not use the processes of its parent.

        Raises
        ------
        InputError
            If no process can be started.
        """
        found = None
        while cls._idle:
            idle = cls._idle.pop()
            if found is None and idle._is_free():
                found = idle
            else:
                idle.end()
        if found is not None:
            return found
        try:
            return cls()
        except OSError as cause:
            raise InputError(
                f"{path} is read in a process of its own, which cannot be started"
                f" ({cause}); close other files or programs, and try again."
            ) from cause

    def _is_free(self) -> bool:
        """Return whether the process has closed its file and waits; False if it hangs or has crashed."""
        if self._owner != os.getpid():
            return False
        self.close_file()
        return self._closing and self._limited({"wait": True}, _ENDS_WITHIN_S)[0] is not None

    def close_file(self) -> None:
        """Request that the process close its file, without waiting for its answer."""
        if not self._closing and self._owner == os.getpid() and self._process.poll() is None:
            self._closing = self._send({})

    def put_back(self) -> None:
        """Keep the process for another file."""
        self._idle.append(self)

    def end(self) -> None:
        """End the process: close its pipes, so that it ends by itself, and kill it if it does not."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with suppress(OSError):  # closing sends a buffered request, and the process may have ended
                    pipe.close()
        if self._owner == os.getpid():
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_ENDS_WITHIN_S)
            self._process.kill()
            self._process.wait()

    def ask(self, path: Path, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to a request about a file; rows in it are a pyarrow table.

        Raises
        ------
        InputError
            If the file cannot be read, or the process has ended or takes too long.
        """
        if self._owner != os.getpid():
            raise InputError(f"{path} was opened before this process was forked from another; open it here.")
        limit_s = LONGEST_S + file_bytes(path) / BYTES_PER_S
        answer, late = self._limited(request, limit_s)
        if answer is None:
            raise InputError(self._why_it_ended(path, late, limit_s))
        if "error" in answer:
            raise getattr(errors, answer["error"])(answer["says"])
        return answer

    def _limited(self, request: Mapping[str, Any], limit_s: float) -> tuple[dict[str, Any] | None, bool]:
        """Return the answer to a request, None if the process failed, and whether it exceeded the time limit."""
        late = Event()

        def stop() -> None:
            late.set()
            self._process.kill()

        timer = Timer(limit_s, stop)
        timer.daemon = True
        with self._asking:
            try:
                timer.start()
                return self._answer(request), late.is_set()
            except (OSError, ValueError, pa.ArrowException):
                self._process.kill()
                return None, late.is_set()
            except BaseException:  # the process may still answer, and the next request must not get that answer
                self._process.kill()
                raise
            finally:
                timer.cancel()

    def _answer(self, request: Mapping[str, Any]) -> dict[str, Any] | None:
        answers = self._process.stdout
        if answers is None:
            return None
        if "wait" not in request and not self._send(request):
            return None
        line = answers.readline()
        if not line.endswith(b"\n"):
            return None
        answer: dict[str, Any] = json.loads(line)
        if answer.get("rows") is True:
            with pa.ipc.open_stream(answers) as stream:
                answer["rows"] = stream.read_all()
        self._closing = False
        return answer

    def _send(self, request: Mapping[str, Any]) -> bool:
        """Send a request, an empty one to close the file; return whether it could be sent."""
        requests = self._process.stdin
        if requests is None:
            return False
        try:
            requests.write(json.dumps(request).encode() + b"\n")
            requests.flush()
        except (OSError, ValueError):
            return False
        return True

    def _why_it_ended(self, path: Path, late: bool, limit_s: float) -> str:
        self._process.kill()
        code = self._process.wait()
        if late:
            return (
                f"{path} was not read within {limit_s:.0f} s; its library hangs, as with a damaged file. Copy or"
                " download it again."
            )
        return (
            f"{path} cannot be read: its library crashed ({_ending(code)}), as with a damaged file. Copy or download"
            " it again."
        )


def _widen(pipe: IO[bytes] | None) -> None:
    """Enlarge the buffer of a pipe where the system allows it, so that rows come in fewer parts."""
    if pipe is not None and sys.platform == "linux":
        import fcntl

        with suppress(OSError):
            fcntl.fcntl(pipe.fileno(), fcntl.F_SETPIPE_SZ, _PIPE_BYTES)


def _ending(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"


@atexit.register
def _end_idle() -> None:
    while _LibraryProcess._idle:
        _LibraryProcess._idle.pop().end()
