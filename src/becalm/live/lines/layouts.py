"""How lines are written, seen from the first of them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from becalm.files.text.cells import GONE, NUMBER, WORDS, kind_of, split
from becalm.files.text.csv_header import find_header, unique_names
from becalm.live.lines.cells import number_of
from becalm.live.lines.columns import LineOptions, columns_of
from becalm.live.lines.rows import CsvLayout, JsonLayout, LineLayout, json_object

_SEPARATORS = (";", "\t", ",", "|", " ", "")  # in a draw the earlier one wins
_REMARK = "#%/"
_DIGIT = re.compile("[0-9]")


def layout_of(above: Sequence[bytes], line: bytes, options: LineOptions) -> tuple[LineLayout, list[bytes]] | None:
    """Understand lines by the newest and those above it; None where it is no row, or not enough to tell.

    A row of CSV has numbers, and above it stands a line of as many names, or another such row; or its names were
    told. Where it has words too, another such row must stand above it in any case.

    Parameters
    ----------
    above : sequence of bytes
        Lines that were not understood.
    line : bytes
        The newest.
    options : LineOptions
        What was said of them.

    Returns
    -------
    LineLayout
        How they are written.
    list of bytes
        Those of the lines above that hold names and units.

    Raises
    ------
    UsageError
        If a column that was named is not there, or more than one could be the time.
    """
    if options.format != "csv" and (told := _json_layout(line, options)):
        return told, []
    row = _plain_text(line)
    if options.format == "json" or row is None or not _DIGIT.search(row):
        return None
    texts = [text for text in map(_plain_text, above) if text is not None]
    found = list(_csv_rows(texts, row, options))
    if not found:
        return None
    separator, cells = max(found, key=lambda one: len(one[1]))
    heading = _heading(texts, separator, cells, options)
    if separator != ",":
        cells = [cell.replace(",", ".") for cell in cells]
    columns = columns_of(heading.names, heading.units, cells, options)
    if columns is None:
        return None
    return CsvLayout(columns, separator), [text.encode() for text in heading.lines]


def may_be_names(line: bytes) -> bool:
    """Whether a line holds words only, however it is cut."""
    text = _plain_text(line)
    return text is not None and all(
        kind_of(cell) in (WORDS, GONE) for separator in _SEPARATORS for cell in split(text, separator)
    )


def _json_layout(line: bytes, options: LineOptions) -> JsonLayout | None:
    told = json_object(line)
    if told is None:
        return None
    names = options.columns or tuple(told)
    first = [told.get(name) for name in names]
    if not any(isinstance(cell, float) for cell in first):
        return None
    columns = columns_of(names, [""] * len(names), first, options)
    return None if columns is None else JsonLayout(columns)


def _plain_text(line: bytes) -> str | None:
    """Return a line as text; None for noise."""
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError:
        return None
    return text if text.replace("\t", " ").isprintable() else None


def _csv_rows(above: Sequence[str], row: str, options: LineOptions) -> Iterator[tuple[str, list[str]]]:
    """Give each way to cut a line into cells that can be a row."""
    for separator in _SEPARATORS:
        cells = split(row, separator)
        kinds = [kind_of(cell) for cell in cells]
        words = kinds.count(WORDS)
        if NUMBER not in kinds or 2 * words >= len(cells):
            continue
        named = any(_is_heading(text, separator, len(cells)) for text in above)
        if options.columns:
            named = len(cells) == len(options.columns)
        if (named and not words) or ((named or not options.columns) and above and _alike(above[-1], separator, kinds)):
            yield separator, cells


def _alike(text: str, separator: str, kinds: Sequence[str]) -> bool:
    """Whether a line has cells of the same kinds: then words in one of them are no bad reading."""
    cells = split(text, separator)
    pairs = zip(cells, kinds, strict=False)
    return len(cells) == len(kinds) and all((kind_of(cell) == WORDS) == (kind == WORDS) for cell, kind in pairs)


def _is_heading(text: str, separator: str, width: int) -> bool:
    cells = split(text.lstrip(_REMARK + " "), separator)
    return len(cells) == width and all(kind_of(cell) in (WORDS, GONE) for cell in cells) and any(cells)


class _Heading(NamedTuple):
    names: Sequence[str]
    units: Sequence[str]
    lines: list[str]


def _heading(above: Sequence[str], separator: str, row: Sequence[str], options: LineOptions) -> _Heading:
    """Return names and units of the columns: as told, from the lines above, or numbered."""
    if options.columns:
        return _Heading(options.columns, [""] * len(row), [])
    lines = list(dict.fromkeys(text for text in above if _is_heading(text, separator, len(row))))
    kinds = tuple(NUMBER if number_of(cell) is not None else kind_of(cell) for cell in row)
    header = find_header(lines[-2:], 0, separator, kinds)
    if not any(header.units):  # then the line above the names is none of theirs
        header = find_header(lines[-1:], 0, separator, kinds)
    return _Heading(unique_names(header.names), header.units, lines[-2:] if any(header.units) else lines[-1:])
