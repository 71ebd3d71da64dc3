"""Reproduce a paper: write a page of tables and figures into a folder."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from becalm.errors import UsageError
from becalm.files.atomic_file import make_folder, refuse_unwritable

PAPERS = ("car", "imu", "strain")


def run(paper: str, folder: Path) -> None:
    """Write the page of a paper into a folder, with figures if they can be drawn, and print the page.

    Raises
    ------
    UsageError
        If there is no such paper.
    OutputError
        If the folder cannot be made or written; this is checked before the computation.
    """
    if paper not in PAPERS:
        raise UsageError(f"There is no paper {paper!r}; write becalm study {' or '.join(PAPERS)}.")
    make_folder(folder)
    refuse_unwritable(folder / f"{paper}.md")
    print(import_module(f"becalm.studies.{paper}.{paper}_page").run(folder))  # noqa: T201  (the page is the data)
