"""Which sensors are finished, and of what their output came: a mark in the output, written last."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from becalm.errors import InputError
from becalm.files.decoding import PARQUET
from becalm.files.lake.marks import FILES
from becalm.files.text_file import write_text
from becalm.fleet.outcome import Outcome
from becalm.installation import version

_LENGTH = 4  # bytes of the length of a Parquet file's footer, before the four that end it
_HELD, _SIZES, _JOB = "held", "sizes", "job"


@dataclass(frozen=True)
class CompletionMark:
    """What a finished sensor came of.

    Attributes
    ----------
    came_of : str
        Hash of its files, its recipe and all that was asked.
    files : tuple of str
        Its output, by paths from the folder of the mark.
    outcome : Outcome
        What became of it.
    sizes : tuple of int
        Of these files, in bytes.
    job : str
        Which made it.
    held : tuple of str
        While a new output takes the place of an older one: files of both.
    """

    came_of: str
    files: tuple[str, ...]
    outcome: Outcome
    sizes: tuple[int, ...] = ()
    held: tuple[str, ...] = ()
    job: str = ""

    @property
    def own(self) -> set[str]:
        """All files that becalm wrote where the mark is."""
        return {*self.files, *self.held}

    def is_whole(self, folder: Path) -> bool:
        """Whether all files are in a folder, and as long as they were."""
        try:
            found = tuple((folder / name).stat().st_size for name in self.files)
        except OSError:
            return False
        return found == self.sizes

    def write(self, path: Path) -> None:
        """Say that the output of a sensor is complete.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        told: dict[str, Any] = {FILES: self.files, "came_of": self.came_of, "outcome": self.outcome.as_dict()}
        told |= {_SIZES: self.sizes, _HELD: self.held, _JOB: self.job}
        write_text(path, json.dumps(told, indent=1) + "\n")

    @classmethod
    def of(cls, path: Path) -> CompletionMark | None:
        """Read a mark; None where there is none, or a damaged one: then nothing says whose files are there."""
        try:
            told = json.loads(path.read_text(encoding="utf-8"))
            outcome = Outcome.from_dict(told["outcome"])
            return cls(
                told["came_of"],
                tuple(told[FILES]),
                outcome,
                tuple(told[_SIZES]),
                tuple(told[_HELD]),
                told.get(_JOB, ""),
            )
        except (OSError, ValueError, KeyError, TypeError):
            return None


def came_of(files: Sequence[tuple[str, Path]], recipe: str, asked: Mapping[str, Any]) -> str:
    """Return the hash of all that an output comes of.

    Parameters
    ----------
    files : sequence of (str, Path)
        Names and places of the input.
    recipe : str
        Text of the recipe.
    asked : mapping
        Settings that change what is written, as JSON has them.

    Raises
    ------
    InputError
        If a file cannot be read.

    Notes
    -----
    Of a file its size, the time of its last change and its footer are taken, which holds where each column chunk is,
    how long, and between which values: a lake need not be read again to find that nothing has changed.
    """
    digest = hashlib.sha256(json.dumps([version(), recipe, asked], sort_keys=True).encode())
    for name, path in files:
        digest.update(json.dumps([name, *_facts(path)]).encode())
    return digest.hexdigest()


def _facts(path: Path) -> tuple[int, int, str]:
    try:
        with path.open("rb") as file:
            found = path.stat()
            file.seek(max(0, found.st_size - 2 * _LENGTH))
            length, ends = int.from_bytes(file.read(_LENGTH), "little"), file.read()
            if ends != PARQUET:  # cut short: where a footer's length would be is anything
                return found.st_size, found.st_mtime_ns, ""
            file.seek(max(0, found.st_size - 2 * _LENGTH - length))
            return found.st_size, found.st_mtime_ns, hashlib.sha256(file.read()).hexdigest()
    except OSError as cause:
        raise InputError(f"{path} cannot be read ({cause.strerror or cause}).") from cause
