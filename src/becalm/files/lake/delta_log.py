"""Read the log of a Delta table, which names the files that hold its current rows."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

from becalm.errors import InputError

NAME = "_delta_log"
"""The folder of the log, in the folder of the table."""

_MAPPING = "delta.columnMapping.mode"


def live_files(root: Path) -> set[tuple[str, ...]]:
    """Return the files that hold the current rows of a table, each as the parts of its path from the table's folder.

    Parameters
    ----------
    root : Path
        The folder of the table.

    Raises
    ------
    InputError
        If deltalake is not installed, the log is damaged, or the rows cannot be read from the files alone.
    """
    try:
        library = import_module("deltalake")
    except ModuleNotFoundError as cause:
        raise InputError(
            f"{root} is a Delta table, whose log is read by deltalake; that is not installed."
            " Type: pip install 'becalm[delta]'"
        ) from cause
    try:
        table = library.DeltaTable(root)
        paths, feature = _paths(table), _unsupported_feature(table)
    except Exception as cause:  # deltalake raises many kinds of exceptions
        reason = " ".join(str(cause).split())[:200]
        raise InputError(f"{root} is a damaged Delta table ({reason}); copy or write it again.") from cause
    if feature:
        raise InputError(
            f"{root} is a Delta table with {feature}, which its Parquet files alone do not show; write its rows to"
            " plain Parquet with the engine that made it, and read those."
        )
    return {PurePosixPath(unquote(path, errors="surrogateescape")).parts for path in paths}


def _paths(table: Any) -> list[str]:
    """Return the files of a table as in its log: as relative URIs."""
    paths: list[str] = table.get_add_actions().column("path").to_pylist()
    return paths


def _unsupported_feature(table: Any) -> str:
    """Return the feature of a table that changes rows or names without changing its files, "" if it has none."""
    if table.metadata().configuration.get(_MAPPING, "none") != "none":
        return "mapped column names"
    if "deletionVectors" not in (table.protocol().reader_features or ()):
        return ""
    if not hasattr(table, "deletion_vectors"):  # early releases of deltalake cannot list them
        return "deletion vectors"
    return "deleted rows" if any(batch.num_rows for batch in table.deletion_vectors()) else ""
