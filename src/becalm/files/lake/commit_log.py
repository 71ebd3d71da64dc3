"""The log of a folder that an engine writes to, or its mark: which of its files count, wherever the folder is now."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path

from becalm.files.decoding import told
from becalm.files.lake import delta_log, marks, spark_log

Parts = tuple[str, ...]

_READERS: dict[str, Callable[[Path], Collection[Parts]]] = {
    delta_log.NAME: delta_log.live_files,
    spark_log.NAME: spark_log.committed_files,
    marks.NAME: marks.marked_files,
}
_WHOLE = (spark_log.NAME,)  # name files by all of their paths, which may have been moved since; others from the root on


class CommitLog:
    """What a log names.

    Parameters
    ----------
    root : Path
        The folder that it is of.
    named : collection of tuple of str
        Parts of the paths of its files, as they were when the log was written.
    whole : bool
        Whether these are whole paths, and not from the root on.
    """

    def __init__(self, root: Path, named: Collection[Parts], *, whole: bool) -> None:
        self.root, self._named, self._whole = root, named, whole
        self._ends: dict[int, set[Parts]] = {}

    def names(self, below: Parts) -> bool:
        """Whether it names a file, by the path from its root: all above may have been moved since."""
        if not self._whole:
            return below in self._named
        ends = self._ends.setdefault(len(below), {one[-len(below) :] for one in self._named})
        return below in ends

    def missing(self, found: Collection[Parts], under: Parts) -> list[Parts]:
        """List what it names, of some folder below its root, and is not there.

        Parameters
        ----------
        found : collection of tuple of str
            What is in that folder, by paths from the root.
        under : tuple of str
            The path from the root to that folder.
        """
        named = self._from_root(next(iter(found), None))
        return sorted(one for one in named.difference(found) if one[: len(under)] == under)

    def _from_root(self, one_found: Parts | None) -> set[Parts]:
        """Return what it names by paths from the root; nothing where a file that was found does not tell these."""
        if not self._whole:
            return set(self._named)
        places = {one[: -len(one_found)] for one in self._named if one_found and one[-len(one_found) :] == one_found}
        if len(places) != 1:
            return set()
        place = places.pop()
        return {one[len(place) :] for one in self._named if one[: len(place)] == place}


def log_of(folder: Path) -> CommitLog | None:
    """Read the log that is in a folder, if there is one.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    with told(folder):
        names = [name for name in _READERS if (folder / name).exists()]
    return CommitLog(folder, _READERS[names[0]](folder), whole=names[0] in _WHOLE) if names else None
