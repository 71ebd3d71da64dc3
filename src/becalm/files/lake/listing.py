"""Which files of a folder hold its rows: all Parquet in it, but what is hidden, or what a log does not name."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from becalm.errors import InputError
from becalm.files.decoding import PARQUET, told
from becalm.files.lake.commit_log import CommitLog, Parts, log_of

ENDINGS = (".parquet", ".pq")
"""Of files that hold rows."""

_PARTITION = re.compile(r"[^=]+=.*", re.DOTALL)


class Listing(NamedTuple):
    """What a folder holds.

    Attributes
    ----------
    files : tuple of Path
        Its Parquet files, in the order of their names, in which numbers count as numbers.
    notes : tuple of str
        Which files were left out, and which are missing, as sentences.
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()


class _Found(NamedTuple):
    path: Path
    log: CommitLog | None
    below: Parts  # from the folder of the log

    @property
    def counts(self) -> bool:
        return self.log is None or self.log.names(self.below)


def parquet_files(folder: Path) -> Listing:
    """List the Parquet files of a folder, at any depth, that count.

    What begins with `_` or `.` is not data. Where a stream of Spark, Delta, or a job of becalm keeps a log in the
    folder, in one that it is a partition of, or in one inside of it, only files that this log names do.

    Raises
    ------
    InputError
        If the folder or a log cannot be read, or no file counts.
    """
    log, under = _log_above(folder)
    found = list(_walked(folder, log, under))
    files = sorted((one.path for one in found if one.counts), key=lambda path: natural(path.relative_to(folder)))
    if not files:
        raise _nothing(folder, [one for one in found if one.log is not None])
    logs = {one.log: () if one.log is not log else under for one in found if one.log is not None}
    return Listing(tuple(files), tuple(note for one in logs.items() for note in _notes(*one, found)))


def is_partition(name: str) -> bool:
    """Whether a folder is called as those that tables are split into: `key=value`."""
    return _PARTITION.fullmatch(name) is not None


def is_hidden(name: str) -> bool:
    """Whether a file or folder is no data by its name, as Spark has it: `_id=17` is a partition."""
    return name.startswith(".") or (name.startswith("_") and not is_partition(name))


def natural(path: Path) -> list[list[str | int]]:
    """Return what orders paths as people do: `part-2` before `part-10`."""
    return [
        [int(bit) if bit.isascii() and bit.isdecimal() else bit for bit in re.split(r"([0-9]+)", part)]
        for part in path.parts
    ]


def _nothing(folder: Path, unnamed: list[_Found]) -> InputError:
    if unnamed and (log := unnamed[0].log):
        return InputError(
            f"{folder} holds no Parquet file that the log of {log.root} names: what is in it was never finished, or"
            " was replaced since."
        )
    return InputError(
        f"{folder} is a directory; give the path of one file in it, or of a folder with Parquet files, which is read as"
        " one recording."
    )


def _notes(log: CommitLog, under: Parts, found: list[_Found]) -> Iterator[str]:
    own = [one for one in found if one.log is log]
    if unnamed := [one for one in own if not one.counts]:
        yield (
            f"{_files(len(unnamed))} that the log of {log.root} does not name, as {unnamed[0].path.name}, left out:"
            " never finished, or replaced since."
        )
    if missing := log.missing({one.below for one in own if one.counts}, under):
        yield (
            f"{_files(len(missing))} that the log of {log.root} names, as {'/'.join(missing[0])}, not there: the rows"
            " in them are missing."
        )


def _files(count: int) -> str:
    return "One file" if count == 1 else f"{count:,} files"


def _log_above(folder: Path) -> tuple[CommitLog | None, Parts]:
    """Find the log that is in a folder, or in one that it is a partition of, and the path from there."""
    if log := log_of(folder):
        return log, ()
    place, under = folder.resolve(), tuple[str, ...]()
    while is_partition(place.name):
        place, under = place.parent, (place.name, *under)
        if log := log_of(place):
            return log, under
    return None, ()


class _Place(NamedTuple):
    path: Path
    log: CommitLog | None
    below: Parts


def _walked(folder: Path, log: CommitLog | None, below: Parts) -> Iterator[_Found]:
    """Give the Parquet files of a folder and of those in it; none twice, wherever links lead to.

    Links are followed in the end, so that folders and files are found under their own names.
    """
    seen, left = set[Path](), deque([_Place(folder, log, below)])
    links, linked = deque[_Place](), list[_Found]()
    while left or links:
        place = left.popleft() if left else links.popleft()
        if (real := place.path.resolve()) in seen:
            continue
        seen.add(real)
        with told(place.path):
            paths = sorted(place.path.iterdir())
        for path in (path for path in paths if not is_hidden(path.name)):
            deeper = (*place.below, path.name)
            if path.is_dir():
                own = log_of(path)
                (links if path.is_symlink() else left).append(_Place(path, own or place.log, () if own else deeper))
            elif _is_parquet(path):
                found = _Found(path, place.log, deeper)
                if path.is_symlink():
                    linked.append(found)
                else:
                    seen.add(real / path.name)
                    yield found
    for found in linked:
        if (real := found.path.resolve()) not in seen:
            seen.add(real)
            yield found


def _is_parquet(path: Path) -> bool:
    """Whether a file is called Parquet, or is it by its first bytes, as Hive's is, whose name has no ending."""
    named = path.name.lower().endswith(ENDINGS)
    with told(path):
        if named:
            return path.is_file() or not path.exists()  # who reads a link that leads nowhere will say so
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(PARQUET)) == PARQUET
