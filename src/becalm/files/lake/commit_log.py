"""Read the commit log of a folder, by Delta, Spark or a fleet job; it names the files that hold the rows."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path

from becalm.files.decoding import explain_read_errors
from becalm.files.lake import delta_log, marks, spark_log

Parts = tuple[str, ...]
"""The parts of a path: names of nested folders, and last the name of the file."""

_READERS: dict[str, Callable[[Path], Collection[Parts]]] = {
    delta_log.NAME: delta_log.live_files,
    spark_log.NAME: spark_log.committed_files,
    marks.NAME: marks.marked_files,
}
_WHOLE = (spark_log.NAME,)  # logs with the absolute paths of files; other logs have paths relative to the root


class CommitLog:
    """The files that a commit log names.

    Parameters
    ----------
    root : Path
        The folder of the log.
    named : collection of tuple of str
        The paths of the files when the log was written, each as its parts.
    whole : bool
        Whether these paths are absolute; otherwise they are relative to the root.
    """

    def __init__(self, root: Path, named: Collection[Parts], *, whole: bool) -> None:
        self.root, self._named, self._whole = root, named, whole
        self._ends: dict[int, set[Parts]] = {}

    def names(self, below: Parts) -> bool:
        """Return whether the log names a file, given by its path from the root, even if the root was moved."""
        if not self._whole:
            return below in self._named
        ends = self._ends.setdefault(len(below), {one[-len(below) :] for one in self._named})
        return below in ends

    def missing(self, found: Collection[Parts], under: Parts) -> list[Parts]:
        """Return the files of a folder that the log names and that are missing, by paths from the root.

        Parameters
        ----------
        found : collection of tuple of str
            The files that are in the folder, by paths from the root.
        under : tuple of str
            The path from the root to the folder.
        """
        named = self._from_root(next(iter(found), None))
        return sorted(one for one in named.difference(found) if one[: len(under)] == under)

    def _from_root(self, present: Parts | None) -> set[Parts]:
        """Return the named files by paths from the root.

        If the paths of the log are absolute, `present`, a file that exists, shows where the root was. The set is empty
        if that is unknown or ambiguous.
        """
        if not self._whole:
            return set(self._named)
        roots = {one[: -len(present)] for one in self._named if present and one[-len(present) :] == present}
        if len(roots) != 1:
            return set()
        root = roots.pop()
        return {one[len(root) :] for one in self._named if one[: len(root)] == root}


def log_of(folder: Path) -> CommitLog | None:
    """Read the log in a folder; return None if there is none.

    Raises
    ------
    InputError
        If the log cannot be read.
    """
    with explain_read_errors(folder):
        names = [name for name in _READERS if (folder / name).exists()]
    return CommitLog(folder, _READERS[names[0]](folder), whole=names[0] in _WHOLE) if names else None
