"""Who writes a journal, and a second witness, outside of its database, of how far the stream was kept."""

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
_SEAL = 32


class Mark(NamedTuple):
    """Where the stream stood after a commit: a database that holds less has lost something."""

    head: Head
    checkpoint: Checkpoint


class MarkFile:
    """The file of the mark, written after each commit, so that it is never ahead of what is kept.

    It is not forced to the disk: after a power cut it may be older than the journal, or torn, which is no mark.

    Parameters
    ----------
    folder : Path
        Of the journal.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "journal.mark"

    def read(self) -> Mark | None:
        """Return the mark; None where there is none that is whole."""
        try:
            content = self.path.read_bytes()
        except OSError:
            return None
        body = content[len(_MAGIC) + _SEAL :]
        if content[: len(_MAGIC) + _SEAL] != _MAGIC + sha256(body).digest():
            return None
        told, _, snapshot = body.partition(b"\n")
        fields = json.loads(told)
        head, rest = fields["head"], fields["checkpoint"]
        names, units = tuple(head["names"]), tuple(head["units"])
        return Mark(
            Head(names, units, head["rate_hz"], rest["recipe"]),
            Checkpoint(rest["rows"], rest["position"], snapshot, rest["recipe"], rest["source"]),
        )

    def write(self, mark: Mark) -> None:
        """Write where the stream stands; where that cannot be, the old mark or none will do."""
        head, at = mark.head, mark.checkpoint
        shared = {"names": head.names, "units": head.units, "rate_hz": head.rate_hz}
        stands = {"rows": at.rows, "position": at.position, "recipe": at.recipe, "source": at.source}
        body = json.dumps({"head": shared, "checkpoint": stands}).encode() + b"\n" + at.snapshot
        content = _MAGIC + sha256(body).digest() + body
        with suppress(OSError):
            handle = os.open(self.path, os.O_WRONLY | os.O_CREAT, 0o666)
            try:
                os.write(handle, content)
                os.ftruncate(handle, len(content))
            finally:
                os.close(handle)


def locked(folder: Path) -> sqlite3.Connection:
    """Keep other processes from writing the same journal, until the connection is closed or the process ends.

    Raises
    ------
    UsageError
        If another one does.
    StorageFullError
        If the folder cannot be written.
    """
    refusal = (
        f"Another becalm writes the journal in {folder}. Stop it first, or give this stream a folder of its own:"
        " --sink journal:OTHER."
    )
    with writing(folder):
        return locking.locked(folder / "journal.lock", refusal)
