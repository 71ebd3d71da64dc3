"""Print how a file was read: columns, units and time, as tables."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from becalm.files.inputs.time_bases import OpenFile


def summary(opened: OpenFile) -> dict[str, Any]:
    """Return the layout of a file for JSON: one layout, or for several time bases a list of layouts."""
    layouts = [source.layout.as_dict() for source in opened.sources]
    if len(layouts) == 1 and not opened.passed_through:
        return layouts[0]
    passed = [
        {"group": raw.group, "rows": raw.count, "columns": raw.names, "why": why} for raw, why in opened.passed_through
    ]
    return {"times": layouts, "passed": passed}


def show(file: Path, opened: OpenFile) -> None:
    """Print the layout of a file on stdout."""
    out = Console(highlight=False, soft_wrap=True, markup=False)
    out.print(f"{file}")
    for source in opened.sources:
        _show_time(out, source.layout.as_dict())
    for raw, why in opened.passed_through:
        out.print(f"Nothing to clean: {raw.group} ({why}).")


def _show_time(out: Console, layout: dict[str, Any]) -> None:
    columns = layout.pop("columns")
    layout["notes"] = " ".join(layout["notes"])
    facts = Table(box=None, show_header=False, pad_edge=False)
    for key, value in layout.items():
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
