"""Mark finished sensors. A mark is a small file in the output, written last, with a hash of the input."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from becalm.errors import InputError
from becalm.files.atomic_file import write_text
from becalm.files.decoding import PARQUET
from becalm.files.lake.marks import FILES
from becalm.fleet.outcome import Outcome
from becalm.installation import version

_LENGTH = 4  # bytes of the footer's length in a Parquet file; four magic bytes follow at the end of the file
_HELD, _SIZES, _JOB = "held", "sizes", "job"


@dataclass(frozen=True)
class CompletionMark:
    """A mark which says that the output of a sensor is complete, and from which input it was made.

    Attributes
    ----------
    input_hash : str
        Hash of the sensor's input files, recipe and options.
    files : tuple of str
        The output files, as paths from the folder of the mark.
    outcome : Outcome
        The outcome of the sensor.
    sizes : tuple of int
        Sizes of `files`, in bytes.
    job : str
        The `job_id` of the job that wrote the files.
    held : tuple of str
        While files are moved, the files of the new and of the older output; `files` is then empty.
    """

    input_hash: str
    files: tuple[str, ...]
    outcome: Outcome
    sizes: tuple[int, ...] = ()
    held: tuple[str, ...] = ()
    job: str = ""

    @property
    def own(self) -> set[str]:
        """Return the names of all files that becalm wrote, or was going to write, in the folder of the mark."""
        return {*self.files, *self.held}

    def is_whole(self, folder: Path) -> bool:
        """Return whether all files are in a folder and have the sizes in the mark."""
        try:
            sizes = tuple((folder / name).stat().st_size for name in self.files)
        except OSError:
            return False
        return sizes == self.sizes

    def write(self, path: Path) -> None:
        """Write the mark as a JSON file.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        content: dict[str, Any] = {FILES: self.files, "came_of": self.input_hash, "outcome": self.outcome.as_dict()}
        content |= {_SIZES: self.sizes, _HELD: self.held, _JOB: self.job}
        write_text(path, json.dumps(content, indent=1) + "\n")

    @classmethod
    def of(cls, path: Path) -> CompletionMark | None:
        """Read a mark; return None if it is missing or damaged, because the output may then have foreign files."""
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            outcome = Outcome.from_dict(content["outcome"])
            return cls(
                content["came_of"],
                tuple(content[FILES]),
                outcome,
                tuple(content[_SIZES]),
                tuple(content[_HELD]),
                content.get(_JOB, ""),
            )
        except (OSError, ValueError, KeyError, TypeError):
            return None


def hash_input(files: Sequence[tuple[str, Path]], recipe: str, asked: Mapping[str, Any]) -> str:
    """Return a hash of everything that determines an output: files, recipe, options and becalm's version.

    Parameters
    ----------
    files : sequence of (str, Path)
        Names and paths of the input files.
    recipe : str
        Text of the recipe.
    asked : mapping
        Options that change the output, as JSON values.

    Raises
    ------
    InputError
        If a file cannot be read.

    Notes
    -----
    For each file, the hash covers the size, the modification time and the Parquet footer. The footer has the position,
    the length and the range of values of each column chunk. Therefore a job detects changes without reading all rows.
    """
    digest = hashlib.sha256(json.dumps([version(), recipe, asked], sort_keys=True).encode())
    for name, path in files:
        digest.update(json.dumps([name, *_facts(path)]).encode())
    return digest.hexdigest()


def _facts(path: Path) -> tuple[int, int, str]:
    """Return a file's size in bytes, its modification time in ns, and the hash of its footer, or "" without one."""
    try:
        with path.open("rb") as file:
            status = path.stat()
            file.seek(max(0, status.st_size - 2 * _LENGTH))
            length, ends = int.from_bytes(file.read(_LENGTH), "little"), file.read()
            if ends != PARQUET:  # truncated: the bytes in place of the footer's length are arbitrary
                return status.st_size, status.st_mtime_ns, ""
            file.seek(max(0, status.st_size - 2 * _LENGTH - length))
            return status.st_size, status.st_mtime_ns, hashlib.sha256(file.read()).hexdigest()
    except OSError as cause:
        raise InputError(f"{path} cannot be read ({cause.strerror or cause}).") from cause
