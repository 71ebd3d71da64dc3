"""How a file was understood, as tables for a person."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from becalm.files.source import Layout


def show(file: Path, layout: Layout) -> None:
    """Print the layout of a file on stdout."""
    out = Console(highlight=False, soft_wrap=True, markup=False)
    told = layout.as_dict()
    columns = told.pop("columns")
    out.print(f"{file}")
    facts = Table(box=None, show_header=False, pad_edge=False)
    for key, value in told.items():
        if value not in (None, "", [], ()):
            facts.add_row(key.replace("_", " "), _plain(value))
    out.print(facts)
    table: Table | None = None
    for column in columns if isinstance(columns, list) else []:
        if table is None:
            table = Table(*column, box=None, pad_edge=False)
        table.add_row(*map(_plain, column.values()))
    if table is not None:
        out.print(table)


def _plain(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, list | tuple):
        return ", ".join(map(_plain, value))
    return "" if value is None else str(value)
