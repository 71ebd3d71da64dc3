"""Commands in processes of their own, without waiting for what each would import: one process has, and forks for each.

A command begins in the fork as `python -m becalm` does: with its own arguments, folder, environment, input and outputs.
"""

from __future__ import annotations

import gc
import json
import os
import runpy
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

_OWN = {"COLUMNS", "PYTEST_CURRENT_TEST"}
"""What of the environment a command is told; the rest is read when modules are loaded."""

_BEGUN = {**os.environ, "COLUMNS": "200"}  # a console asks for its width when it is loaded


def command(
    words: Sequence[str], folder: Path, environment: dict[str, str], given: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run becalm and wait for its end.

    Parameters
    ----------
    words : sequence of str
        What stands behind `becalm`.
    folder : Path
        Where it runs.
    environment : dict of str to str
        All of it.
    given : str
        Its standard input, which is a pipe.

    Returns
    -------
    CompletedProcess of str
        How it ended, and what it said.
    """
    with tempfile.TemporaryDirectory() as beside:
        paths = [Path(beside) / name for name in ("given", "out", "err")]
        paths[0].write_text(given, encoding="utf-8")
        asked = {"words": words, "folder": str(folder), "environment": environment, "paths": [*map(str, paths)]}
        begun = _server()
        assert begun.stdin is not None
        assert begun.stdout is not None
        begun.stdin.write(json.dumps(asked) + "\n")
        begun.stdin.flush()
        code = int(begun.stdout.readline())
        out, err = (path.read_text(encoding="utf-8") for path in paths[1:])
    return subprocess.CompletedProcess(words, code, out, err)


def can_fork(environment: dict[str, str]) -> bool:
    """Whether a fork begins in this environment as a process would."""
    names = (environment.keys() | _BEGUN.keys()) - _OWN
    return hasattr(os, "fork") and all(environment.get(name) == _BEGUN.get(name) for name in names)


@cache
def _server() -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, __file__], env=_BEGUN, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def _load() -> None:
    """Load what most commands do, but start no thread: a fork has none."""
    import pyarrow.csv
    import pyarrow.parquet  # noqa: F401
    import rich.progress  # noqa: F401
    import scipy.signal  # noqa: F401

    from becalm.cleaning import pipeline  # noqa: F401
    from becalm.cli import main, messages, report_files  # noqa: F401
    from becalm.cli.commands import clean, compare, export, noise  # noqa: F401
    from becalm.files import source  # noqa: F401
    from becalm.report import page  # noqa: F401

    if find_spec("pandas"):
        import pandas  # noqa: F401  (which pyarrow loads where it is)
    if find_spec("matplotlib"):
        import matplotlib.backends.backend_svg
        import matplotlib.figure  # noqa: F401
    gc.freeze()  # a fork that collects garbage copies no page of these


def _serve() -> None:
    _load()
    assert threading.active_count() == 1, "a fork has only the thread that asked for it"
    for line in sys.stdin:
        asked = json.loads(line)
        child = os.fork()
        if not child:
            _become(asked)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        print(code, flush=True)  # noqa: T201


def _become(asked: dict[str, Any]) -> None:
    """Be the command, to its end."""
    os.chdir(asked["folder"])
    os.environ.clear()
    os.environ.update(asked["environment"])
    given, *outputs = map(Path, asked["paths"])
    os.dup2(_piped(given.read_bytes()), 0)
    for number, path in enumerate(outputs, 1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
    modes = enumerate("rww")
    sys.stdin, sys.stdout, sys.stderr = (os.fdopen(number, mode, encoding="utf-8") for number, mode in modes)
    sys.argv = ["becalm", *asked["words"]]
    with suppress(SystemExit):
        runpy.run_module("becalm", run_name="__main__", alter_sys=True)
    os._exit(1)  # it ends itself


def _piped(given: bytes) -> int:
    """Return the end of a pipe that another process writes into."""
    end, begin = os.pipe()
    if not os.fork():
        os.close(end)
        with suppress(BrokenPipeError), os.fdopen(begin, "wb") as pipe:
            pipe.write(given)
        os._exit(0)
    os.close(begin)
    return end


if __name__ == "__main__":
    _serve()
