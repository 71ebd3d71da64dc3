"""Read the log of a Spark stream, which names the files that were committed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit

from becalm.errors import InputError
from becalm.files.decoding import explain_read_errors

NAME = "_spark_metadata"
"""The folder of the log, in the folder that the stream writes to."""

_BATCH = re.compile(r"([0-9]+)(\.compact)?")
_VERSION = "v1"


def committed_files(root: Path) -> set[tuple[str, ...]]:
    """Return the files that a stream committed, each as the parts of its path when it was written.

    Parameters
    ----------
    root : Path
        The folder that the stream writes to, or a copy of it.

    Raises
    ------
    InputError
        If the log is damaged, incomplete, or cannot be read.
    """
    live: set[tuple[str, ...]] = set()
    for batch in _batches(root / NAME):
        for path, action in _entries(batch):
            if action == "delete":
                live.discard(path)
            else:
                live.add(path)
    return live


def _batches(log: Path) -> list[Path]:
    """Return the batches to read, in order: the last compacted batch, which includes all before it, and later ones."""
    with explain_read_errors(log):
        names = [path.name for path in log.iterdir()]
    batches = [(int(match[1]), bool(match[2])) for match in map(_BATCH.fullmatch, names) if match]
    start = max((number for number, compact in batches if compact), default=None)
    plain = {number for number, compact in batches if not compact and (start is None or number > start)}
    first = 0 if start is None else start + 1
    if missing := set(range(first, max(plain, default=first - 1))) - plain:
        raise InputError(
            f"{log} lacks the batch {min(missing)}, so the list of committed files is incomplete; copy all of it again."
        )
    return ([] if start is None else [log / f"{start}.compact"]) + [log / str(number) for number in sorted(plain)]


def _entries(batch: Path) -> Iterator[tuple[tuple[str, ...], str]]:
    with explain_read_errors(batch):
        lines = batch.read_text(encoding="utf-8").splitlines()
    if lines[:1] != [_VERSION]:
        problem = f"begins with {lines[0][:20]!r}" if lines else "is empty"
        raise InputError(f"{batch} {problem}; the log of a stream begins with {_VERSION!r}. Copy it again.")
    for line in lines[1:]:
        try:
            entry = json.loads(line)
            uri, action = entry["path"], entry["action"]
            path = PurePosixPath(unquote(urlsplit(uri).path, errors="surrogateescape"))
        except (ValueError, TypeError, KeyError, AttributeError) as cause:
            raise InputError(f"{batch} is damaged: {line[:60]!r} does not name a file; copy it again.") from cause
        yield path.parts, action
