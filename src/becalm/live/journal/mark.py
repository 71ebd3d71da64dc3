"""The journal's lock, and its mark: a copy of the last checkpoint outside the database."""

from __future__ import annotations

import json
import os
import sqlite3
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from becalm.live import locking
from becalm.live.block import Checkpoint, Head
from becalm.live.journal.database import writing

_MAGIC = b"becalm journal mark 1\n"
_SEAL = 32  # bytes of a SHA-256 digest


class Mark(NamedTuple):
    """Head and checkpoint of the last commit; a database with fewer rows than the checkpoint has lost rows."""

    head: Head
    checkpoint: Checkpoint


class MarkFile:
    """The file of the mark; it is written after each commit, so that it is never ahead of the database.

    The file is written without fsync: after a power cut it may be older than the database, or incomplete and ignored.

    Parameters
    ----------
    folder : Path
        Folder of the journal.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "journal.mark"

    def read(self) -> Mark | None:
        """Return the mark; None if the file is absent or damaged."""
        try:
            content = self.path.read_bytes()
        except OSError:
            return None
        body = content[len(_MAGIC) + _SEAL :]
        if content[: len(_MAGIC) + _SEAL] != _MAGIC + sha256(body).digest():
            return None
        text, _, snapshot = body.partition(b"\n")
        fields = json.loads(text)
        head, rest = fields["head"], fields["checkpoint"]
        names, units = tuple(head["names"]), tuple(head["units"])
        return Mark(
            Head(names, units, head["rate_hz"], rest["recipe"]),
            Checkpoint(rest["rows"], rest["position"], snapshot, rest["recipe"], rest["source"]),
        )

    def write(self, mark: Mark) -> None:
        """Write the mark; errors are ignored, because an old mark or none is acceptable."""
        head, last = mark.head, mark.checkpoint
        head_fields = {"names": head.names, "units": head.units, "rate_hz": head.rate_hz}
        fields = {"rows": last.rows, "position": last.position, "recipe": last.recipe, "source": last.source}
        body = json.dumps({"head": head_fields, "checkpoint": fields}).encode() + b"\n" + last.snapshot
        content = _MAGIC + sha256(body).digest() + body
        with suppress(OSError):
            handle = os.open(self.path, os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
            try:
                os.write(handle, content)
                os.ftruncate(handle, len(content))
            finally:
                os.close(handle)


def lock_journal(folder: Path) -> sqlite3.Connection:
    """Lock a journal against other writers; return the connection that holds the lock until it is closed.

    Raises
    ------
    UsageError
        If another process writes the journal.
    StorageFullError
        If the folder cannot be written.
    """
    refusal = (
        f"Another becalm process writes the journal in {folder}. Stop it first, or give this stream another folder:"
        " --sink journal:OTHER."
    )
    with writing(folder):
        return locking.lock_file(folder / "journal.lock", refusal)
