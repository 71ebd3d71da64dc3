"""A process that keeps a stream until it is killed, or dies at a step that is named: python journal_writer.py DIR."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

STEPS = {
    "before a row group": ("becalm.live.journal.rolling.output_table", False),
    "after a file was written": ("becalm.live.journal.rolling.hashlib.file_digest", True),
    "before a file is renamed": ("pathlib.Path.replace", False),
    "after a file was renamed": ("pathlib.Path.replace", True),
    "before a file is recorded": ("becalm.live.journal.records.RollRow._replace", False),
    "amid recording": ("becalm.live.journal.parquet_files.put", True),
    "after recording": ("becalm.live.journal.rolling_thread.Roller.forget", False),
    "amid removing blocks": ("becalm.live.journal.journal.remove_rolled", True),
    "before a file is pruned": ("becalm.live.journal.rolling_thread.remove", False),
}
"""Where a process may die: a function, and whether after it."""


def writing(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    """Start this program."""
    return subprocess.Popen(
        [sys.executable, __file__, str(folder), *words],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": path()},
    )


def path() -> str:
    """Return where the project and what its tests share are found."""
    import becalm

    return os.pathsep.join([str(Path(becalm.__file__).parents[1]), str(Path(__file__).parent)])


def die_at(step: str) -> None:
    """Let this process end at a step, at once, as if killed; a step that every block takes counts once one rolled."""
    place, after = STEPS[step]
    where, _, name = place.rpartition(".")
    owner = resolve_name(where)
    old: Callable[..., Any] = getattr(owner, name)

    def dying(*values: Any, **named: Any) -> Any:
        early = (name == "forget" and values[1] == 0) or (name == "remove_rolled" and not has_rolled(values))
        told = old(*values, **named) if after or early else None
        if not early:
            os._exit(9)
        return told

    setattr(owner, name, dying)


def has_rolled(values: tuple[Any, ...]) -> bool:
    """Whether a block counts no more, by a connection."""
    from becalm.live.journal.database import last_rolled_block

    return last_rolled_block(values[0]) > 0


def main() -> None:
    """Keep blocks for ever, or so many."""
    from journals import checkpoint_at, journal_in, rows_of

    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--options", default="")
    parser.add_argument("--rows", type=int, default=100)
    parser.add_argument("--blocks", type=int, default=1 << 60)
    parser.add_argument("--die", choices=STEPS)
    asked = parser.parse_args()
    if asked.die:
        die_at(asked.die)
    with journal_in(asked.folder, asked.options) as journal:
        checkpoint = journal.last()
        row = 0 if checkpoint is None else checkpoint.rows
        print("begins", row, flush=True)  # noqa: T201
        for _ in range(asked.blocks):
            journal.commit([rows_of(row, asked.rows)], checkpoint_at(row + asked.rows))
            row += asked.rows
            print(row, flush=True)  # noqa: T201
            if asked.die:
                journal.wait_until_rolled(5)


if __name__ == "__main__":
    main()
