"""The log of a Delta table: which files hold its rows now."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

from becalm.errors import InputError

NAME = "_delta_log"
"""The folder that holds it, in that of the table."""

_MAPPING = "delta.columnMapping.mode"


def live_files(root: Path) -> set[tuple[str, ...]]:
    """Return the files that hold the rows of a table now, each as the parts of its path in it.

    Parameters
    ----------
    root : Path
        The folder of the table.

    Raises
    ------
    InputError
        If the library that reads the log is not here, the log is damaged, or the files alone do not tell the rows.
    """
    try:
        library = import_module("deltalake")
    except ModuleNotFoundError as cause:
        raise InputError(
            f"{root} is a Delta table, whose log is read by deltalake; that is not here."
            " Type: pip install 'becalm[delta]'"
        ) from cause
    try:
        table = library.DeltaTable(root)
        told, hidden = _paths(table), _hidden(table)
    except Exception as cause:  # what deltalake raises is of many kinds
        reason = " ".join(str(cause).split())[:200]
        raise InputError(f"{root} is a damaged Delta table ({reason}); copy or write it again.") from cause
    if hidden:
        raise InputError(
            f"{root} is a Delta table with {hidden}, of which its Parquet files alone do not tell; write its rows to"
            " plain Parquet with the engine that made it, and read those."
        )
    return {PurePosixPath(unquote(path, errors="surrogateescape")).parts for path in told}


def _paths(table: Any) -> list[str]:
    """List its files as the log has them: relative URIs."""
    found: list[str] = table.get_add_actions().column("path").to_pylist()
    return found


def _hidden(table: Any) -> str:
    """Say what changes rows or names without being in the files; "" where nothing does."""
    if table.metadata().configuration.get(_MAPPING, "none") != "none":
        return "mapped column names"
    if "deletionVectors" not in (table.protocol().reader_features or ()):
        return ""
    if not hasattr(table, "deletion_vectors"):  # of an early release, which cannot tell
        return "deletion vectors"
    return "deleted rows" if any(batch.num_rows for batch in table.deletion_vectors()) else ""
