"""`becalm live` in processes of its own, and what they leave."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa

from becalm.live.journal.reading import open_journal

DEADLINE_S = 120.0


def kept(folder: Path) -> pa.Table:
    with open_journal(folder) as reader:
        return pa.concat_tables([*reader.tables()], promote_options="default")


@contextmanager
def begun(folder: Path, words: Sequence[object], **more: Any) -> Iterator[subprocess.Popen[bytes]]:
    """Start becalm live in a process of its own."""
    command = [sys.executable, "-m", "becalm", "live", *map(str, words)]
    process = subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, **more)
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()


def until(true: Any) -> None:
    end = time.monotonic() + DEADLINE_S
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


def told_in(path: Path) -> dict[str, Any]:
    try:
        told: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return told


def rows_in(path: Path) -> int:
    return int(told_in(path).get("rows", 0))
