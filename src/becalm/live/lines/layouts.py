"""Detect the layout of lines from the first ones: CSV or JSON, separator, names and units."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from becalm.files.text.cells import MISSING_CELL, NUMBER, WORDS, kind_of, split
from becalm.files.text.csv_header import find_header, unique_names
from becalm.live.lines.cells import number_of
from becalm.live.lines.columns import LineOptions, columns_of
from becalm.live.lines.rows import CsvLayout, JsonLayout, LineLayout, json_object

_SEPARATORS = (";", "\t", ",", "|", " ", "")  # if several give the same number of cells, the first wins
_REMARK = "#%/"  # characters that may precede the names in a header
_DIGIT = re.compile("[0-9]")


def layout_of(above: Sequence[bytes], line: bytes, options: LineOptions) -> tuple[LineLayout, list[bytes]] | None:
    """Return the layout from the newest line and the lines above it; None if they are not enough.

    The newest line is a row of CSV if it has numbers, words in fewer than half of its cells, and one of these holds:

    - It has no words, and a line above, or the option `columns` if it is given, has a name for each cell.
    - The line directly above has as many cells, with words in the same places. If the option `columns` is given, it
      must also have a name for each cell.

    Parameters
    ----------
    above : sequence of bytes
        Earlier lines whose layout is unknown.
    line : bytes
        Newest line.
    options : LineOptions
        Format, columns, time and rate of the lines.

    Returns
    -------
    LineLayout
        Layout of the lines.
    list of bytes
        Lines above that contain names and units.

    Raises
    ------
    UsageError
        If a column in the options is absent, or more than one could be the time.
    """
    if options.format != "csv" and (layout := _json_layout(line, options)):
        return layout, []
    row = _plain_text(line)
    if options.format == "json" or row is None or not _DIGIT.search(row):
        return None
    texts = [text for text in map(_plain_text, above) if text is not None]
    candidates = list(_csv_rows(texts, row, options))
    if not candidates:
        return None
    separator, cells = max(candidates, key=lambda one: len(one[1]))
    heading = _heading(texts, separator, cells, options)
    if separator != ",":
        cells = [cell.replace(",", ".") for cell in cells]
    columns = columns_of(heading.names, heading.units, cells, options)
    if columns is None:
        return None
    lines = [text.encode() for text in heading.lines]
    return CsvLayout(columns, separator, lines), lines


def may_be_names(line: bytes) -> bool:
    """Return whether a line has only words, whichever separator it has."""
    text = _plain_text(line)
    return text is not None and all(
        kind_of(cell) in (WORDS, MISSING_CELL) for separator in _SEPARATORS for cell in split(text, separator)
    )


def _json_layout(line: bytes, options: LineOptions) -> JsonLayout | None:
    row = json_object(line)
    if row is None:
        return None
    names = options.columns or tuple(row)
    first = [row.get(name) for name in names]
    if not any(isinstance(cell, float) for cell in first):
        return None
    columns = columns_of(names, [""] * len(names), first, options)
    return None if columns is None else JsonLayout(columns, is_open=not (options.columns or options.channels))


def _plain_text(line: bytes) -> str | None:
    """Return a line as text; None if it is not printable text."""
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError:
        return None
    return text if text.replace("\t", " ").isprintable() else None


def _csv_rows(above: Sequence[str], row: str, options: LineOptions) -> Iterator[tuple[str, list[str]]]:
    """Yield each separator with which the line `row` is a row of CSV, and the cells of the line."""
    for separator in _SEPARATORS:
        cells = split(row, separator)
        kinds = [kind_of(cell) for cell in cells]
        words = kinds.count(WORDS)
        if NUMBER not in kinds or 2 * words >= len(cells):
            continue
        has_names = any(_is_heading(text, separator, len(cells)) for text in above)
        if options.columns:
            has_names = len(cells) == len(options.columns)
        may_follow = has_names or not options.columns
        if (has_names and not words) or (may_follow and above and _has_kinds(above[-1], separator, kinds)):
            yield separator, cells


def _has_kinds(text: str, separator: str, kinds: Sequence[str]) -> bool:
    """Return whether a line has as many cells as `kinds`, with words in the same places."""
    cells = split(text, separator)
    pairs = zip(cells, kinds, strict=False)
    return len(cells) == len(kinds) and all((kind_of(cell) == WORDS) == (kind == WORDS) for cell, kind in pairs)


def _is_heading(text: str, separator: str, width: int) -> bool:
    cells = split(text.lstrip(_REMARK + " "), separator)
    return len(cells) == width and all(kind_of(cell) in (WORDS, MISSING_CELL) for cell in cells) and any(cells)


class _Heading(NamedTuple):
    names: Sequence[str]
    units: Sequence[str]
    lines: list[str]


def _heading(above: Sequence[str], separator: str, row: Sequence[str], options: LineOptions) -> _Heading:
    """Return names and units of the columns: from the options, from the lines above, or numbered."""
    if options.columns:
        return _Heading(options.columns, [""] * len(row), [])
    lines = list(dict.fromkeys(text for text in above if _is_heading(text, separator, len(row))))
    kinds = tuple(NUMBER if number_of(cell) is not None else kind_of(cell) for cell in row)
    header = find_header(lines[-2:], 0, separator, kinds)
    if not any(header.units):  # then only the last line is the header
        header = find_header(lines[-1:], 0, separator, kinds)
    return _Heading(unique_names(header.names), header.units, lines[-2:] if any(header.units) else lines[-1:])
