"""The output of one sensor: a file for each that it came in; all of them appear, and then the mark that says so."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import pyarrow as pa

from becalm.files.atomic_file import sentences, sync_folder
from becalm.files.registry import PARQUET_FORMAT
from becalm.files.temporary_files import in_waiting
from becalm.files.text_file import make_folder
from becalm.files.writing import TableOutput, open_output

STAGED = ".becalm.*.part"
"""Names of folders whose files have no names of their own yet."""


class OutputFile(NamedTuple):
    """A file to write."""

    name: str  # within the output of its sensor
    rows: int


@contextmanager
def staging(folder: Path) -> Iterator[Path]:
    """Give a folder, in another, for files that have no names of their own yet; it is gone in the end.

    Raises
    ------
    OutputError
        If it cannot be made.
    """
    staged = open_staging(folder)
    with in_waiting(staged):
        yield staged


def open_staging(folder: Path) -> Path:
    """Make such a folder for several processes; whoever is the last removes it.

    Raises
    ------
    OutputError
        If it cannot be made.
    """
    staged = folder / STAGED.replace("*", secrets.token_hex(6))
    make_folder(staged)
    return staged


def put_in_place(staged: Path, folder: Path, names: Sequence[str]) -> None:
    """Give files their own names: out of the folder that they were written in, into another.

    Raises
    ------
    OutputError
        If that cannot be done; it can be repeated.
    """
    for name in names:
        target = folder / name
        make_folder(target.parent)
        with sentences(target):
            (staged / name).replace(target)
    for place in {(folder / name).parent for name in names}:
        with sentences(place):
            sync_folder(place)


class Pieces:
    """Writes rows to one file after the other, in a `with`.

    Parameters
    ----------
    folder : Path
        Where to.
    pieces : sequence of OutputFile
        All of them, in the order of their rows.
    metadata : mapping of str to str
        Kept in each file.
    """

    def __init__(self, folder: Path, pieces: Sequence[OutputFile], metadata: Mapping[str, str]) -> None:
        self._folder, self._metadata, self._stack = folder, metadata, ExitStack()
        self._left = list(pieces)
        self._output: TableOutput | None = None
        self._room = 0  # rows that the open file still takes

    def write(self, table: pa.Table) -> None:
        """Write the next rows, to the file that they belong to, or to several.

        Raises
        ------
        OutputError
            If they cannot be written.
        """
        at = 0
        while at < table.num_rows:
            output = self._opened()
            part = table.slice(at, self._room)
            output.write(part)
            at, self._room = at + part.num_rows, self._room - part.num_rows

    def _opened(self) -> TableOutput:
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
        """Finish the file that is open, or give it up where something went wrong."""
        self._stack.__exit__(kind, cause, trace)
