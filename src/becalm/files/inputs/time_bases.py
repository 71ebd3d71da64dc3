"""Open a file with all its time bases, each as a source of its own."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from becalm.errors import InputError, UsageError
from becalm.files.groups import chosen_table, holds, listed
from becalm.files.inputs.opening import OpenSource, close, in_chosen_units, open_table
from becalm.files.read_options import ReadOptions, refuse_impossible
from becalm.files.registry import read_tables
from becalm.files.source import RawTable


class PassedThroughTable(NamedTuple):
    """A table of a file that is not cleaned.

    Attributes
    ----------
    raw : RawTable
        The table as it is in the file.
    why : str
        The reason, in a sentence or a few words.
    """

    raw: RawTable
    why: str


class OpenFile(NamedTuple):
    """An open file with all its tables; made by `open_file`.

    Attributes
    ----------
    sources : tuple of OpenSource
        One source or more, each with channels and a time of its own.
    passed_through : tuple of PassedThroughTable
        The other tables of the file.
    """

    sources: tuple[OpenSource, ...]
    passed_through: tuple[PassedThroughTable, ...]


@contextmanager
def open_file(path: str | os.PathLike[str], options: ReadOptions | None = None) -> Iterator[OpenFile]:
    """Open all time bases of a file, or those that the options select, and close them at the end of the block.

    Parameters
    ----------
    path : path-like
        The file; its content decides the format.
    options : ReadOptions, optional
        Options that the user gives; by default time and channels are found in the file.

    Raises
    ------
    InputError
        If the file cannot be read, or nothing in it can be cleaned.
    UsageError
        If the options do not fit the file.
    """
    file, options = Path(path), options or ReadOptions()
    refuse_impossible(options)
    tables = read_tables(file)
    opened: list[OpenSource] = []
    try:
        tables, options = in_chosen_units(tables, options)
        passed_through = list(_open_each(file, tables, options, opened))
        if not opened:
            raise InputError(f"Nothing in {file} can be cleaned: {'; '.join(one.why for one in passed_through[:10])}")
        yield OpenFile(tuple(opened), tuple(passed_through))
    finally:
        for source in opened:
            source.close()
        close(tables)


def _open_each(
    file: Path, tables: Sequence[RawTable], options: ReadOptions, opened: list[OpenSource]
) -> Iterator[PassedThroughTable]:
    """Append a source to `opened` for each selected table, and yield the other tables."""
    if len(tables) == 1 or options.group is not None:
        chosen = chosen_table(file, tables, options)
        opened.append(open_table(file, chosen, options))
        yield from (PassedThroughTable(table, "not asked for") for table in tables if table is not chosen)
        return
    if options.rate_hz is not None or options.time is not None:
        raise UsageError(
            f"--rate and --time are for a single time base, but {file} holds {listed(tables)}. Choose one with --group."
        )
    _refuse_unknown_channels(file, tables, options)
    for table in tables:
        channels = None if options.channels is None else tuple(name for name in options.channels if holds(table, name))
        if channels == ():
            yield PassedThroughTable(table, "not asked for")
            continue
        try:
            opened.append(open_table(file, table, replace(options, channels=channels)))
        except InputError as cause:
            if channels is not None:
                raise
            yield PassedThroughTable(table, f"{table.group}: {str(cause).removeprefix(f'{file}: ')}")


def _refuse_unknown_channels(file: Path, tables: Sequence[RawTable], options: ReadOptions) -> None:
    for name in options.channels or ():
        if not any(holds(table, name) for table in tables):
            raise UsageError(
                f"{options.origin.name} names {name!r}, which is not in {file}; it holds"
                f" {listed(tables)}.{options.origin.advice}"
            )
