"""Write the output files of one sensor, one for each input file, in a staging folder; then move them all."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import pyarrow as pa

from becalm.files.atomic_file import explain_write_errors, make_folder, removed_afterwards, sync_folder
from becalm.files.outputs.writing import TableOutput, open_output
from becalm.files.registry import PARQUET_FORMAT

STAGED = ".becalm.*.part"
"""Pattern that matches the names of staging folders."""


class OutputFile(NamedTuple):
    """An output file of a sensor."""

    name: str  # path within the output folder of the sensor
    rows: int  # number of rows


@contextmanager
def staging(folder: Path) -> Iterator[Path]:
    """Make a staging folder in `folder`; it is removed at the end of the `with`.

    Raises
    ------
    OutputError
        If the staging folder cannot be made.
    """
    staged = open_staging(folder)
    with removed_afterwards(staged):
        yield staged


def open_staging(folder: Path) -> Path:
    """Make a staging folder in `folder`, and return its path; the caller, or the end of the job, removes it.

    Raises
    ------
    OutputError
        If the staging folder cannot be made.
    """
    staged = folder / STAGED.replace("*", secrets.token_hex(6))
    make_folder(staged)
    return staged


def put_in_place(staged: Path, folder: Path, names: Sequence[str]) -> None:
    """Move files from the staging folder into `folder`, and sync that folder to disk.

    Raises
    ------
    OutputError
        If a file cannot be moved.
    """
    for name in names:
        target = folder / name
        make_folder(target.parent)
        with explain_write_errors(target):
            (staged / name).replace(target)
    for place in {(folder / name).parent for name in names}:
        with explain_write_errors(place):
            sync_folder(place)


class Pieces:
    """A writer that divides a sequence of rows among several files; for use in a `with`.

    Parameters
    ----------
    folder : Path
        The folder of the files.
    pieces : sequence of OutputFile
        The files, in the order of their rows.
    metadata : mapping of str to str
        Metadata stored in each file.
    """

    def __init__(self, folder: Path, pieces: Sequence[OutputFile], metadata: Mapping[str, str]) -> None:
        self._folder, self._metadata, self._stack = folder, metadata, ExitStack()
        self._left = list(pieces)
        self._output: TableOutput | None = None
        self._room = 0  # rows that the open file has yet to receive

    def write(self, table: pa.Table) -> None:
        """Write the next rows; a table may continue in the next file.

        Raises
        ------
        OutputError
            If a file cannot be written.
        """
        at = 0
        while at < table.num_rows:
            output = self._open_output()
            part = table.slice(at, self._room)
            output.write(part)
            at, self._room = at + part.num_rows, self._room - part.num_rows

    def _open_output(self) -> TableOutput:
        if self._output is None or not self._room:
            self._stack.close()
            piece = self._left.pop(0)
            target, self._room = self._folder / piece.name, piece.rows
            make_folder(target.parent)
            self._output = self._stack.enter_context(open_output(target, self._metadata, PARQUET_FORMAT))
        return self._output

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, cause: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the open file; after an exception, discard it."""
        self._stack.__exit__(kind, cause, trace)
