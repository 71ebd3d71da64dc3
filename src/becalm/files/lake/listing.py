"""List the files of a folder that hold its rows: its Parquet files except hidden ones and those that a log omits."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from becalm.errors import InputError
from becalm.files.decoding import PARQUET, explain_read_errors
from becalm.files.lake.commit_log import CommitLog, Parts, log_of
from becalm.files.parquet import PARQUET_ENDINGS

_PARTITION = re.compile(r"[^=]+=.*", re.DOTALL)


class Listing(NamedTuple):
    """The Parquet files of a folder.

    Attributes
    ----------
    files : tuple of Path
        The files that hold rows, sorted by name, with numbers in names in numeric order.
    notes : tuple of str
        Sentences for the user about files that are left out, and files that are missing.
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()


class _ParquetFile(NamedTuple):
    path: Path
    log: CommitLog | None
    below: Parts  # its path from the folder of the log, or of the listing if there is no log

    @property
    def counts(self) -> bool:
        """Return whether the file holds rows: its log names it, or there is no log."""
        return self.log is None or self.log.names(self.below)


def parquet_files(folder: Path) -> Listing:
    """List the Parquet files of a folder, at any depth, that hold its rows.

    Names that begin with `_` or `.` are not data. If Spark, Delta or a fleet job of becalm keeps a log, only the files
    that it names count. The log is in the folder, in a subfolder, or in the table that has the folder as a partition.

    Raises
    ------
    InputError
        If the folder or a log cannot be read, or no file counts.
    """
    log, under = _log_above(folder)
    found = list(_walk(folder, log, under))
    files = sorted((one.path for one in found if one.counts), key=lambda path: natural(path.relative_to(folder)))
    if not files:
        raise _no_files_error(folder, [one for one in found if one.log is not None])
    logs = {one.log: () if one.log is not log else under for one in found if one.log is not None}
    return Listing(tuple(files), tuple(note for one in logs.items() for note in _notes(*one, found)))


def is_partition(name: str) -> bool:
    """Return whether a folder's name is that of a partition of a table: `key=value`."""
    return _PARTITION.fullmatch(name) is not None


def is_hidden(name: str) -> bool:
    """Return whether a name marks a file or folder as not data, by the rules of Spark; `_id=17` is a partition."""
    return name.startswith(".") or (name.startswith("_") and not is_partition(name))


def natural(path: Path) -> list[list[str | int]]:
    """Return a key that sorts paths with numbers in numeric order: `part-2` before `part-10`."""
    return [
        [int(bit) if bit.isascii() and bit.isdecimal() else bit for bit in re.split(r"([0-9]+)", part)]
        for part in path.parts
    ]


def _no_files_error(folder: Path, unnamed: list[_ParquetFile]) -> InputError:
    if unnamed and (log := unnamed[0].log):
        return InputError(
            f"{folder} holds no Parquet file that the log of {log.root} names: its files were never finished, or were"
            " replaced since."
        )
    return InputError(
        f"{folder} is a directory; give the path of one file in it, or of a folder with Parquet files, which is read as"
        " one recording."
    )


def _notes(log: CommitLog, under: Parts, found: list[_ParquetFile]) -> Iterator[str]:
    own = [one for one in found if one.log is log]
    if unnamed := [one for one in own if not one.counts]:
        yield (
            f"{_files_are(len(unnamed))} left out that the log of {log.root} does not name, such as"
            f" {unnamed[0].path.name}: never finished, or replaced since."
        )
    if missing := log.missing({one.below for one in own if one.counts}, under):
        yield (
            f"{_files_are(len(missing))} missing that the log of {log.root} names, such as {'/'.join(missing[0])}: the"
            " rows in them are missing."
        )


def _files_are(count: int) -> str:
    return "One file is" if count == 1 else f"{count:,} files are"


def _log_above(folder: Path) -> tuple[CommitLog | None, Parts]:
    """Return the log of a folder or of the table that it is a partition of, and the path from the log to the folder."""
    if log := log_of(folder):
        return log, ()
    place, under = folder.resolve(), tuple[str, ...]()
    while is_partition(place.name):
        place, under = place.parent, (place.name, *under)
        if log := log_of(place):
            return log, under
    return None, ()


class _Place(NamedTuple):
    """A folder to list, the log for its files, and its path from the folder of the log."""

    path: Path
    log: CommitLog | None
    below: Parts


def _walk(folder: Path, log: CommitLog | None, below: Parts) -> Iterator[_ParquetFile]:
    """Yield the Parquet files of a folder and of its subfolders, each file once even if links lead to it.

    Links are followed last, so that a folder or file is listed under its own name rather than under that of a link.
    """
    seen, left = set[Path](), deque([_Place(folder, log, below)])
    links, linked = deque[_Place](), list[_ParquetFile]()
    while left or links:
        place = left.popleft() if left else links.popleft()
        if (real := place.path.resolve()) in seen:
            continue
        seen.add(real)
        with explain_read_errors(place.path):
            paths = sorted(place.path.iterdir())
        for path in (path for path in paths if not is_hidden(path.name)):
            deeper = (*place.below, path.name)
            if path.is_dir():
                own = log_of(path)
                (links if path.is_symlink() else left).append(_Place(path, own or place.log, () if own else deeper))
            elif _is_parquet(path):
                file = _ParquetFile(path, place.log, deeper)
                if path.is_symlink():
                    linked.append(file)
                else:
                    seen.add(real / path.name)
                    yield file
    for file in linked:
        if (real := file.path.resolve()) not in seen:
            seen.add(real)
            yield file


def _is_parquet(path: Path) -> bool:
    """Return whether a file is Parquet, by its name's ending or, since Hive writes no ending, by its content."""
    named = path.name.lower().endswith(PARQUET_ENDINGS)
    with explain_read_errors(path):
        if named:
            return path.is_file() or not path.exists()  # the reader reports a link to a missing file
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(PARQUET)) == PARQUET
